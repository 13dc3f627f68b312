"""Configs of ``python -m experiments.evaluate``: the variants of scjax/evaluate/config.py, to copy and change."""

from __future__ import annotations

from scjax.evaluate.config import VARIANTS, get_config

__all__ = ["VARIANTS", "get_config"]
