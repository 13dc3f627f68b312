"""Choices that depend on the backend. Only this file asks JAX which one it is; everything else is plain JAX.

Each choice was measured on CPUs (benchmarks/README.md). Other backends get the plain form.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import jax

_FAST_COMPILE = {"xla_backend_optimization_level": 1, "xla_llvm_disable_expensive_passes": True}
_FASTEST_COMPILE = {**_FAST_COMPILE, "xla_backend_optimization_level": 0}
_SCENES_PER_STEP = 16
_CACHED_SCORES = 2**20 * 7 // 2  # 14 MB in float32


def on_cpu() -> bool:
    """Whether programs run on a CPU by default."""
    return jax.default_backend() == "cpu"


def fast_compile_options(*, light: bool = False) -> dict[str, Any] | None:
    """Compiler options of large programs, that sample or train; None where XLA's defaults serve.

    On a CPU, LLVM's expensive passes take a sixth of the time to compile, and no program is faster for them.

    Args:
      light: the program runs seldom or does little: without any optimization it compiles in two thirds of the time.
    """
    if on_cpu() and not jax.config.values["jax_disable_most_optimizations"]:
        return _FASTEST_COMPILE if light else _FAST_COMPILE
    return None


def scenes_at_once(batch_size: int) -> int:
    """How many scenes of a training batch a device works on at once: 16 on a CPU, all elsewhere.

    On a CPU memory is scarce, and more scenes at once are no faster.
    """
    return _SCENES_PER_STEP if on_cpu() else batch_size


def attention_parts(scenes: int, scores: int) -> int:
    """Number of equal parts into which attention cuts a batch; 1 on other backends than a CPU.

    The scores of a part stay in the cache of a CPU. Long contexts then run 2-4 times faster, forward and backward.

    Args:
      scenes: scenes in the batch.
      scores: attention scores per scene (heads x queries x keys).
    """
    if not on_cpu():
        return 1
    divisors = (n for n in range(1, scenes + 1) if scenes % n == 0)
    return next(n for n in divisors if scenes // n * scores <= _CACHED_SCORES or n == scenes)


def bfloat16_is_faster(backend: str | None = None, cpuinfo: str = "/proc/cpuinfo") -> bool:
    """Whether matrix products with bfloat16 operands are faster than with float32 operands.

    True on GPU and TPU, and on CPUs with AMX or, from AMD, with the bfloat16 instructions of AVX-512 (1.7 times the
    rate of float32 there, 0.55 times on Intel). The CPU's flags decide, not a clock: a resumed training must compute
    as it began.

    Args:
      backend: "cpu", "gpu" or "tpu"; JAX's default backend if None.
      cpuinfo: the file with the CPU's flags.
    """
    if (backend or jax.default_backend()) != "cpu":
        return True
    flags = cpu_flags(cpuinfo)
    return "amx_bf16" in flags or ("avx512_bf16" in flags and "AuthenticAMD" in cpu_entry("vendor_id", cpuinfo))


def cpu_flags(path: str = "/proc/cpuinfo") -> frozenset[str]:
    """Names of the CPU's features, as Linux lists them; empty on other systems."""
    return cpu_entry("flags", path)


@functools.cache
def cpu_entry(name: str, path: str = "/proc/cpuinfo") -> frozenset[str]:
    """The words of one entry of the first processor in ``path``; empty where there is none."""
    try:
        lines = Path(path).read_text().splitlines()
    except OSError:
        return frozenset()
    return frozenset(next((line.split(":", 1)[1].split() for line in lines if line.startswith(name)), ()))
