"""Folders of published networks: any folder with a config.json, or an entry of the Hugging Face cache.

Nothing is downloaded: image encoders come with licenses that their users accept themselves.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from scjax.encoders.base import CONFIG_FILE

_NAME = re.compile(r"[\w.-]+/[\w.-]+")


def find_network_folder(source: str | Path, what: str) -> Path:
    """The folder with config.json and weights.

    Args:
      source: a folder, an entry of the hub's cache (``models--NAME--NAME``), or the name of a network ("NAME/NAME")
        that this cache holds.
      what: the network does, for messages, such as "image encoder".

    Raises:
      ValueError: there is none; the message names the command that downloads one.
    """
    folder = Path(source)
    if not folder.is_dir():
        name = str(source)
        cached = hub_cache() / f"models--{name.replace('/', '--')}"
        if not _NAME.fullmatch(name) or not cached.is_dir():
            cure = f"hf download {name}" if _NAME.fullmatch(name) else "hf download NAME"
            raise ValueError(
                f"{name}: no folder of an {what}, and not in the cache {hub_cache()}: give a folder with {CONFIG_FILE} "
                f"and model.safetensors, or download one with `{cure}`"
            )
        folder = cached
    if (folder / "snapshots").is_dir() and not (folder / CONFIG_FILE).is_file():
        return _snapshot(folder)
    return folder


def hub_cache() -> Path:
    """Where the programs of the hub keep downloads: $HF_HUB_CACHE, $HF_HOME/hub, or the user's cache folder."""
    if folder := os.environ.get("HF_HUB_CACHE"):
        return Path(folder)
    if folder := os.environ.get("HF_HOME"):
        return Path(folder) / "hub"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "huggingface" / "hub"


def _snapshot(entry: Path) -> Path:
    """The snapshot that ``refs/main`` names, else the only one.

    Raises:
      ValueError: there is none, or several and none is main.
    """
    snapshots = sorted(path for path in (entry / "snapshots").iterdir() if (path / CONFIG_FILE).is_file())
    try:
        main = (entry / "refs" / "main").read_text().strip()
    except (OSError, UnicodeError):
        main = ""
    for path in snapshots:
        if path.name == main:
            return path
    if len(snapshots) == 1:
        return snapshots[0]
    problem = f"has {len(snapshots)} snapshots, and refs/main names none of them" if snapshots else "holds no snapshot"
    raise ValueError(f"{entry}: {problem} with a {CONFIG_FILE}: give the folder of one, or download it again")
