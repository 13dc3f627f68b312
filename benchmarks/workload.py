"""The scenes that every benchmark works on, the machine's rooflines, and how steps are timed."""

from __future__ import annotations

import os
import platform
import resource
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from scjax.nn.cpu.backend import cpu_flags
from scjax.scene import Crop, Link, Scene, empty, stack

BUCKETS = ((61, 44), (61, 64), (61, 80), (61, 100))  # (agent, lane) slots


def counts(scenes: int = 64) -> list[tuple[int, int]]:
    """(lanes, agents) of the workload: lanes, then agents, drawn from one generator of seed 0."""
    rng = np.random.default_rng(0)
    lanes, agents = rng.integers(20, 101, scenes), rng.integers(5, 62, scenes)
    return [(int(a), int(b)) for a, b in zip(lanes, agents, strict=True)]


def random_scene(rng: np.random.Generator, lanes: int, agents: int, slots: tuple[int, int]) -> Scene:
    """Random geometry at the given sizes: the work does not depend on what a scene shows."""
    scene = empty(*slots, crop=Crop.CENTERED)
    scene.agents[:agents] = rng.normal(0, 8, (agents, 9))
    angle = rng.uniform(0, 2 * np.pi, agents)
    scene.agents[:agents, 4:6] = np.stack([np.cos(angle), np.sin(angle)], 1)
    scene.agents[:agents, 6:9] = (4.5, 2.0, 1.6)
    scene.lanes[:lanes] = rng.normal(0, 12, (lanes, 20, 3))
    for name, number in (("agent_mask", agents), ("agent_known", agents), ("lane_mask", lanes), ("lane_known", lanes)):
        getattr(scene, name)[:number] = True
    scene.links[np.arange(lanes), np.arange(lanes)] = Link.SELF
    return scene


def batch_counts(batch_size: int, scenes: int = 64) -> list[list[tuple[int, int]]]:
    """(lanes, agents) in batches of ``batch_size`` real scenes, sorted by size so that a batch fits a small bucket.

    Within a batch small and large scenes take turns, so that every device's share is about the same work.
    """
    ordered = sorted(counts(scenes))
    parts = [ordered[start : start + batch_size] for start in range(0, scenes, batch_size)]
    return [part[::2] + part[1::2] for part in parts]


def batches(batch_size: int, scenes: int = 64) -> list[Scene]:
    """The scenes of ``batch_counts``, padded to the bucket of their batch."""
    return padded(batch_counts(batch_size, scenes))


def padded(parts: Sequence[Sequence[tuple[int, int]]]) -> list[Scene]:
    """Random scenes of these (lanes, agents), each batch padded to its bucket."""
    rng = np.random.default_rng(1)
    result = []
    for part in parts:
        slots = bucket(max(lanes for lanes, _ in part), max(agents for _, agents in part))
        result.append(stack([random_scene(rng, lanes, agents, slots) for lanes, agents in part]))
    return result


def evenly(parts: Sequence[Any], number: int) -> list[Any]:
    """``number`` of the batches, spread evenly over the sizes."""
    stride = max(len(parts) // number, 1)
    return list(parts[stride // 2 :: stride])


def bucket(lanes: int, agents: int) -> tuple[int, int]:
    """The first of ``BUCKETS`` that holds a scene."""
    return next(slots for slots in BUCKETS if agents <= slots[0] and lanes <= slots[1])


def best_seconds(run: Callable[[], Any], repeats: int) -> float:
    """Least wall time of ``run`` (which blocks) over some repeats, after one that is not counted."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def rooflines() -> dict[str, float]:
    """GFLOP/s of a large matrix product: float32, and bfloat16 operands accumulated in float32."""
    x = jnp.ones((2048, 2048))
    rates = {}
    for name, dtype in (("float32", jnp.float32), ("bfloat16", jnp.bfloat16)):
        product = jax.jit(
            lambda a, b, dtype=dtype: jnp.dot(a.astype(dtype), b.astype(dtype), preferred_element_type=jnp.float32)
        )
        seconds = best_seconds(lambda product=product: product(x, x).block_until_ready(), 5)
        rates[name] = 2 * 2048**3 / seconds / 1e9
    return rates


def machine() -> dict[str, Any]:
    """What the numbers were taken on."""
    model = next((line.split(":")[1].strip() for line in _cpuinfo() if line.startswith("model name")), "")
    return {
        "cpu": model or platform.processor(),
        "cores": os.cpu_count(),
        "amx": "amx_bf16" in cpu_flags(),
        "avx512_bf16": "avx512_bf16" in cpu_flags(),
        "load_1min": round(os.getloadavg()[0], 2),
        "device": jax.devices()[0].device_kind,
        "jax": jax.__version__,
    }


def peak_memory_gb() -> float:
    """Peak resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as a Markdown table."""
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    for row in rows:
        cells = (f"{row[name]:.3g}" if isinstance(row[name], float) else str(row[name]) for name in names)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cpuinfo() -> list[str]:
    try:
        with open("/proc/cpuinfo") as file:
            return file.read().splitlines()
    except OSError:
        return []
