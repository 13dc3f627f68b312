"""Captioned and embedded records of synthetic worlds, for tests of studies."""

from __future__ import annotations

from pathlib import Path

from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.caption_features import embed_captions
from scjax.data.captions import add_captions
from scjax.synthetic.source import Worlds
from tests.factories.words import Words


def save_captioned_records(folder: Path, *, worlds: int = 16, split_percent: float = 40.0) -> Path:
    """A record folder of ``worlds`` worlds, with both splits; features of ``Words``."""
    build_records(Worlds(3, worlds), folder, BuildOptions(split_percent=split_percent))
    add_captions(folder, texts=3, progress=False)
    embed_captions(folder, Words(), progress=False)
    return folder
