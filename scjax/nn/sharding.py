"""Scenes spread over devices: GPUs, or the cores of a CPU where JAX sees each as a device (``use_every_core``)."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "scenes"


def use_every_core() -> None:
    """Lets JAX see each core of a CPU as a device; without effect once JAX has computed something.

    Small operations that are split over cores wait for each other; devices with a share of the scenes each do not
    (benchmarks/README.md has the measured gain).
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if jax.config.values["jax_num_cpu_devices"] in (-1, None):  # otherwise the user has chosen: JAX_NUM_CPU_DEVICES
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", cores)


def scene_mesh(scenes: int, devices: Sequence[jax.Device] | None = None) -> Mesh:  # pyright: ignore[reportInvalidTypeForm]
    """As many of the devices (default: all) as divide the number of scenes."""
    devices = jax.devices() if devices is None else devices
    if jax.process_count() == 1:
        devices = devices[: math.gcd(scenes, len(devices))]
    return Mesh(np.asarray(devices), (AXIS,))


def replicated(tree: Any, scenes: int) -> Any:
    """A PyTree as arrays that lie on every device over which so many scenes are spread."""
    return jax.device_put(tree, NamedSharding(scene_mesh(scenes), PartitionSpec()))


def spread(function: Callable[..., Any], shared: int) -> Callable[..., Any]:
    """``function`` of batches, each device working on a share of the scenes; to be called under ``jax.jit``.

    Args:
      function: its first ``shared`` arguments belong to all scenes, the others and its results are PyTrees [B, ...].
        Scenes may not depend on each other.
    """

    def run(*arguments: Any) -> Any:
        mesh = scene_mesh(len(jax.tree.leaves(arguments[shared:])[0]))
        if mesh.size == 1:
            return function(*arguments)
        specs = tuple(PartitionSpec() if i < shared else PartitionSpec(AXIS) for i in range(len(arguments)))
        mapped = jax.shard_map(
            function, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(AXIS), check_vma=False
        )  # fmt: skip
        return mapped(*arguments)

    return run
