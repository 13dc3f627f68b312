"""Short hashes that name files by the content they depend on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence

import numpy as np


def content_hash(*parts: str) -> str:
    """A hash of texts (16 hex digits)."""
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def row_text(rows: Sequence[int] | np.ndarray) -> str:
    """Row numbers as text for ``content_hash``."""
    return np.asarray(rows, int).tobytes().hex()
