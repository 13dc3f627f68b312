"""What every command does before it computes."""

from __future__ import annotations

import jax

from scjax.devices import use_every_core
from scjax.encoders.find import cache_folder


def start_jax() -> None:
    """Uses all cores, and keeps compiled programs in the cache folder, for a fast second start."""
    use_every_core()
    if jax.config.values.get("jax_compilation_cache_dir") is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "programs"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
