"""Meshes of devices, batches in equal shares over them, and rules that shard parameters by their path.

Devices are GPUs or TPUs, or the cores of a CPU where JAX sees each core as a device (``use_every_core``).
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import re
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "scenes"

Rules = tuple[tuple[str, PartitionSpec], ...]
"""(pattern, spec): the spec applies to arrays whose path ("blocks/0/kernel") the pattern matches somewhere."""

Sharding = Literal["flat", "fsdp"]

RULES: dict[Sharding, Rules] = {
    # Vectors of all parameters of a group, in equal shares (ZeRO, arXiv:1910.02054).
    "flat": ((r"", PartitionSpec(AXIS)),),
    # Matrices by input features, else by output features; biases, norms and scalars stay whole.
    "fsdp": ((r"kernel$", PartitionSpec(AXIS)), (r"kernel$", PartitionSpec(None, AXIS))),
}
"""How a training state lies on the devices."""


def use_every_core() -> None:
    """Lets JAX see each core of a CPU as a device; without effect once JAX has computed something.

    Small operations that are split over cores wait for each other. Devices with a share of the scenes each do not
    (benchmarks/README.md has the measured gain).
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if jax.config.values["jax_num_cpu_devices"] in (-1, None):  # otherwise the user chose: JAX_NUM_CPU_DEVICES
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", cores)


def scene_mesh(scenes: int, devices: Sequence[jax.Device] | None = None) -> Mesh:  # pyright: ignore[reportInvalidTypeForm]
    """As many of the devices (default: those of this process) as divide the number of scenes."""
    devices = jax.local_devices() if devices is None else devices
    return Mesh(np.asarray(devices[: math.gcd(scenes, len(devices))]), (AXIS,))


def mesh_of_processes(scenes: int) -> Mesh:
    """All devices of all processes; of a single process as many as divide the number of scenes.

    Raises:
      ValueError: there are several processes, and their devices cannot share the scenes evenly.
    """
    if jax.process_count() > 1 and scenes % jax.device_count():
        raise ValueError(
            f"a batch of {scenes} scenes does not divide over {jax.device_count()} devices of {jax.process_count()} "
            "processes: choose another --config.batch.batch_size"
        )
    return scene_mesh(scenes, jax.devices())


def replicated(tree: Any, scenes: int) -> Any:
    """A PyTree as arrays that lie on every device over which so many scenes are spread."""
    return jax.device_put(tree, NamedSharding(scene_mesh(scenes), PartitionSpec()))


def partition_spec(path: str, shape: tuple[int, ...], rules: Rules, devices: int) -> PartitionSpec:
    """The spec of the first rule that matches ``path`` and whose axis divides over so many devices; else whole."""
    for pattern, spec in rules:
        axis = sharded_axis(spec)
        if axis is not None and axis < len(shape) and shape[axis] % devices == 0 and re.search(pattern, path):
            return spec
    return PartitionSpec()


def partition_specs(tree: Any, rules: Rules, devices: int) -> Any:
    """``partition_spec`` of every leaf; a path joins the dict keys, field names and list positions by "/"."""
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: partition_spec(
            jax.tree_util.keystr(path, simple=True, separator="/"), np.shape(leaf), rules, devices
        ),
        tree,
    )


def sharded_axis(spec: PartitionSpec) -> int | None:
    """The array axis that a spec spreads over the devices; None: no axis."""
    return next((axis for axis, name in enumerate(spec) if name == AXIS), None)


def host_copy(tree: Any) -> Any:
    """A PyTree as NumPy arrays on this host, gathered where processes hold a share each."""

    def copy(leaf: Any) -> Any:
        if isinstance(leaf, jax.Array) and not leaf.is_fully_addressable:
            return np.asarray(multihost_utils.process_allgather(leaf, tiled=True))
        return jax.device_get(leaf)

    return jax.tree.map(copy, tree)


def spread(function: Callable[..., Any], shared: int) -> Callable[..., Any]:
    """``function`` of batches, each device working on a share of the scenes; to be called under ``jax.jit``.

    Args:
      function: its first ``shared`` arguments belong to all scenes, the others and its results are PyTrees [B, ...].
        Scenes may not depend on each other.
    """

    @functools.wraps(function)
    def run(*arguments: Any) -> Any:
        mesh = scene_mesh(len(jax.tree.leaves(arguments[shared:])[0]))
        if mesh.size == 1:
            return function(*arguments)
        specs = tuple(PartitionSpec() if i < shared else PartitionSpec(AXIS) for i in range(len(arguments)))
        mapped = jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(AXIS), check_vma=False)
        return mapped(*arguments)

    return run
