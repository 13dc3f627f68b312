"""Measures points of the attention benchmark in this process: JSON points on stdin, JSON lines of results on stdout.

Run by ``benchmarks.attention``, which pins the process and chooses XLA's threads before JAX starts.
"""

from __future__ import annotations

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory

    keep_memory()

import dataclasses
import functools
import json
import math
import resource
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from benchmarks import workload
from scjax.nn.cross_attention import ContextSpec, CrossAttentionOptions, build_cross_attention, from_name
from scjax.nn.functional import Functional, Params, functional

WARM, LEAST, ENOUGH = 3, 20, 2.0  # runs before timing, timed runs at least, seconds after which fewer suffice
_DRIFT = 0.05  # of the roofline between the beginning and the end of a batch


@dataclasses.dataclass(frozen=True)
class Point:
    """One thing to measure.

    Attributes:
      variant: key of ``VARIANTS``. stage: "core" (queries, keys and values given: no projection), "module" (encode and
      attend), "cached" (attend). backward: with gradients by parameters, scene tokens and context.
      n, m, d, heads, scenes: queries, keys, width, heads, batch. image: the context is two grids, else a text.
    """

    variant: str
    stage: str
    backward: bool
    n: int
    m: int
    d: int = 256
    heads: int = 8
    scenes: int = 1
    image: bool = False

    @property
    def spec(self) -> ContextSpec:
        """Two square grids for images (``m`` must be twice a square), else a text."""
        if not self.image:
            return ContextSpec(kind="text")
        side = math.isqrt(self.m // 2)
        return ContextSpec(kind="image", grid=(side, side), modalities=2)


def _sparse(name: str, **fields: Any) -> Callable[[int], CrossAttentionOptions]:
    """Options whose numbers of clusters grow with the context (attention-variants §10)."""
    if name == "saap":
        return lambda m: from_name(name, buckets=max(16, m // 32), probes=max(16, m // 32) // 4, **fields)
    return lambda m: from_name(name, clusters=max(16, m // 16), keep=0.3, rule="top", **fields)


def _fixed(name: str, **fields: Any) -> Callable[[int], CrossAttentionOptions]:
    return lambda m: from_name(name, **fields)


VARIANTS: dict[str, Callable[[int], CrossAttentionOptions]] = {
    "concat": _fixed("concat"),
    "full": _fixed("full"),
    "full, chunked": _fixed("full", chunk=512),
    "full + 32 tokens": _fixed("full", memory_tokens=32),
    "full, 2x parameters": _fixed("full", inner_ratio=2),
    "gated": _fixed("gated"),
    "linear": _fixed("linear"),
    "agent": _fixed("agent"),
    "agent, learned": _fixed("agent", pooling="learned"),
    "saap": _sparse("saap"),
    "windowed": _fixed("windowed", window=64, form="gather"),
    "windowed, dense-masked": _fixed("windowed", window=64),
    "deformable": _fixed("deformable"),
    "squeezed": _sparse("squeezed", form="gather"),
    "squeezed, dense-masked": _sparse("squeezed"),
    "cross_global": _fixed("cross_global"),
}
_LEFT_OUT = {"cross_global": 3, "deformable": 1}  # projections of scene tokens that ``Identity`` replaces; elsewhere 2
DENSE = ("concat", "full", "full + 32 tokens", "gated", "cross_global")


class Identity(nnx.Module):
    """Stands in for a projection where only the core is measured."""

    def __call__(self, x):
        return x


def network(point: Point) -> Functional:
    """The mechanism; for the core, with queries and results that go through no projection."""

    def make(init):
        module = build_cross_attention(VARIANTS[point.variant](point.m), point.d, point.heads, point.spec, init=init)
        if point.stage == "core":
            assert module is not None
            for name in ("q", "out", "latent_out"):
                if hasattr(module, name):
                    setattr(module, name, Identity())
        return module

    return functional(make)


def parameters(module: Functional) -> Params:
    """Initial parameters with sparse selection switched on and random gates, so that no branch is idle."""
    params = jax.device_get(module.init(jax.random.key(0)))
    return params | {name: np.ones(1, np.float32) for name in ("fitted", "gate") if name in params}


def program(point: Point) -> tuple[Callable[..., Any], tuple]:
    """A function to compile and its arguments."""
    module = network(point)
    rng = np.random.default_rng(0)
    x, context = (
        jnp.asarray(rng.normal(size=(point.scenes, size, point.d)), jnp.float32) for size in (point.n, point.m)
    )
    x_mask, mask = (jnp.ones(a.shape[:2], bool) for a in (x, context))
    params = parameters(module)
    cache = (
        None
        if point.stage == "module"
        else jax.jit(functools.partial(module.apply, method="encode"))(params, context, mask)
    )

    def forward(params, x, known):
        cache = module.apply(params, known, mask, method="encode") if point.stage == "module" else known
        return module.apply(params, x, x_mask, cache, method="attend")[0]

    arguments = params, x, context if cache is None else cache
    if not point.backward:
        return forward, arguments

    def loss(params, x, known):
        return jnp.sum(jnp.sin(forward(params, x, known)))

    return jax.grad(loss, (0, 1, 2), allow_int=True), arguments


def closed_form(point: Point) -> float:
    """FLOPs of the stage; forward and backward together count three times the forward."""
    options = VARIANTS[point.variant](point.m)
    work = options.work(point.d, point.heads, point.spec, point.n, point.m)
    macs = work.attend + (work.encode if point.stage == "module" else 0)
    if point.stage == "core":
        macs -= _LEFT_OUT.get(point.variant, 2) * point.n * point.d**2
    return 2 * macs * point.scenes * (3 if point.backward else 1)


def measure(points: list[Point], out=sys.stdout) -> None:
    """Compiles all, then times them in turns; a JSON line a point. A batch during which the machine changed says so."""
    before = workload.rooflines()["float32"]
    compiled = []
    for point in points:
        function, arguments = program(point)
        arguments = jax.device_put(arguments)
        start = time.perf_counter()
        run = jax.jit(function).lower(*arguments).compile()
        compiled.append((run, arguments, time.perf_counter() - start))
        warm: list[float] = []
        while len(warm) < WARM and sum(warm) < ENOUGH:
            warm.append(_timed(run, arguments))
    seconds: list[list[float]] = [[] for _ in points]
    while any(not _enough(times) for times in seconds):
        for times, (run, arguments, _) in zip(seconds, compiled, strict=True):
            if not _enough(times):
                times.append(_timed(run, arguments))
    after = workload.rooflines()["float32"]
    steady = abs(after - before) <= _DRIFT * before
    for point, times, (run, _, compile_seconds) in zip(points, seconds, compiled, strict=True):
        analysis, memory = run.cost_analysis(), run.memory_analysis()
        quarter = statistics.quantiles(times, n=4)
        flops, median = closed_form(point), statistics.median(times)
        row = {
            **dataclasses.asdict(point),
            "median_s": median,
            "iqr_s": quarter[2] - quarter[0],
            "min_s": min(times),
            "runs": len(times),
            "compile_s": compile_seconds,
            "flops_closed": flops,
            "flops_xla": analysis.get("flops"),
            "bytes_xla": analysis.get("bytes accessed"),
            "temp_bytes": memory.temp_size_in_bytes,
            "rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
            "peak_gflops": before,
            "share": flops / median / 1e9 / before,
            "steady": steady,
            **workload.machine(),
        }
        print(json.dumps(row), file=out, flush=True)


def _timed(run: Callable[..., Any], arguments: tuple) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run(*arguments))
    return time.perf_counter() - start


def _enough(times: list[float]) -> bool:
    return len(times) >= LEAST or (len(times) >= 3 and sum(times) >= ENOUGH)


if __name__ == "__main__":
    measure([Point(**one) for one in json.load(sys.stdin)])
