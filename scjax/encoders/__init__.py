"""Frozen encoders of conditions: text into token features."""

from scjax.encoders.base import TextEncoder, TokenFeatures
from scjax.encoders.text import FrozenTextEncoder, load_text_encoder

__all__ = ["FrozenTextEncoder", "TextEncoder", "TokenFeatures", "load_text_encoder"]
