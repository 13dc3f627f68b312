"""Set-up of JAX that every command does first: devices and the cache of compiled programs."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import jax

from scjax.nn.sharding import use_every_core


def cache_folder() -> Path:
    """Where scjax keeps downloads: $SCJAX_CACHE, else the user's cache folder."""
    folder = os.environ.get("SCJAX_CACHE")
    if folder:
        return Path(folder)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "scjax"


def start_jax() -> None:
    """Uses all cores, and keeps compiled programs in the cache folder, for a fast second start.

    Tracing leaves many objects behind: to look for garbage as often as Python does would take a tenth of the time to
    the first scene.
    """
    gc.set_threshold(100_000, 20, 100)
    use_every_core()
    if jax.config.values.get("jax_compilation_cache_dir") is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "programs"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
