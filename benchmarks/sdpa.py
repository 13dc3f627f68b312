"""How fast is masked attention compared with PyTorch's? python -m benchmarks.sdpa (needs the extra ``parity``)

``attend_heads`` as in training (one device per core) against ``scaled_dot_product_attention`` with the same mask on all
cores, at the size of cross-attention on an image: 32 scenes, 8 heads, 161 queries, 392 keys, head width 32, float32.
Both run in turn; the least times are compared. Results must agree to 1e-4 first.
"""

from __future__ import annotations

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory

    keep_memory()

import argparse
import json
import os
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import workload
from scjax.nn.attention import attend_heads
from scjax.nn.sharding import spread, use_every_core

SCENES, HEADS, QUERIES, KEYS, WIDTH = 32, 8, 161, 392, 32
_ROUNDS = 20


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sdpa", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--smoke", action="store_true", help="two rounds of a small size, to see that it runs")
    args = parser.parse_args(arguments)
    try:
        import torch
    except ImportError:
        parser.exit(1, "benchmarks.sdpa: PyTorch is not installed: pip install 'scjax[parity]'\n")
    use_every_core()
    torch.set_num_threads(len(os.sched_getaffinity(0)))
    scenes, rounds = (2, 2) if args.smoke else (SCENES, _ROUNDS)
    rng = np.random.default_rng(0)
    shapes = [(scenes, HEADS, length, WIDTH) for length in (QUERIES, KEYS, KEYS, QUERIES)]
    q, k, v, cotangent = (rng.normal(size=shape).astype(np.float32) for shape in shapes)
    mask = np.arange(KEYS)[None] < rng.integers(KEYS // 2, KEYS + 1, (scenes, 1))

    ours = spread(lambda q, k, v, mask: attend_heads(q, k, v, mask[:, None]), shared=0)
    forward = jax.jit(ours)
    gradient = jax.jit(jax.grad(lambda arrays, mask, cotangent: jnp.vdot(ours(*arrays, mask), cotangent)))
    arrays, target = tuple(map(jnp.asarray, (q, k, v))), jnp.asarray(cotangent)

    tensors = [torch.tensor(x, requires_grad=True) for x in (q, k, v)]
    torch_mask, torch_target = torch.tensor(mask)[:, None, None], torch.tensor(cotangent)

    def their_forward():
        with torch.no_grad():
            return torch.nn.functional.scaled_dot_product_attention(*tensors, attn_mask=torch_mask)

    def their_gradient():
        for tensor in tensors:
            tensor.grad = None
        torch.nn.functional.scaled_dot_product_attention(*tensors, attn_mask=torch_mask).backward(torch_target)
        return [tensor.grad for tensor in tensors]

    np.testing.assert_allclose(forward(*arrays, mask), their_forward().numpy(), atol=1e-4)
    for a, b in zip(gradient(arrays, mask, target), their_gradient(), strict=True):
        np.testing.assert_allclose(a, b.numpy(), atol=1e-4)

    cases: dict[str, Callable[[], object]] = {
        "forward": lambda: jax.block_until_ready(forward(*arrays, mask)),
        "forward, PyTorch": their_forward,
        "forward and backward": lambda: jax.block_until_ready(gradient(arrays, mask, target)),
        "forward and backward, PyTorch": their_gradient,
    }
    seconds = dict.fromkeys(cases, float("inf"))
    for _ in range(rounds):
        for name, run in cases.items():
            seconds[name] = min(seconds[name], workload.best_seconds(run, 1))
    for name in ("forward", "forward and backward"):
        print(
            f"{name}: {seconds[name] * 1e3:.1f} ms, PyTorch {seconds[f'{name}, PyTorch'] * 1e3:.1f} ms, "
            f"ratio {seconds[name] / seconds[f'{name}, PyTorch']:.2f}"
        )
    print(json.dumps({"seconds": seconds, "torch": torch.__version__, **workload.machine()}))


if __name__ == "__main__":
    main()
