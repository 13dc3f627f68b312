"""Captioned and embedded records of synthetic worlds, for tests of studies."""

from __future__ import annotations

from pathlib import Path

from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.caption_features import embed_captions
from scjax.data.captions import add_captions
from scjax.data.measurements import measure_records
from scjax.synthetic.source import Worlds
from tests.factories.words import Words


def save_captioned_records(folder: Path) -> None:
    """A record folder of eight worlds, with both splits: captions, features of ``Words``, measured attributes."""
    build_records(Worlds(3, 8), folder, BuildOptions(split_percent=40.0))
    add_captions(folder, texts=3, progress=False)
    embed_captions(folder, Words(), progress=False)
    measure_records(folder, progress=False)
