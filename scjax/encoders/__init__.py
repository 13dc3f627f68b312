"""Frozen encoders of conditions: text into token features."""

from scjax.encoders.text import TextEncoder, load_text_encoder

__all__ = ["TextEncoder", "load_text_encoder"]
