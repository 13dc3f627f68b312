"""How fast could a step be at most? python -m benchmarks.products [autoencoder|unconditional|text|image] --batch 16

A large matrix product shows what the processor can do, but the products of a network are small. This walks through the
program of a training step (with --sampling, of a guided sampling step), runs every product in it alone, at its own
sizes, with every core at work, and finds at which rate they all run together. Useful work at that rate is the most that
XLA's products allow, whatever lies between them (norms, softmax, gathers, the optimiser) and however little is padded
or computed twice. Prints that bound, and the one by the large product.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from tqdm import tqdm

from benchmarks import workload
from benchmarks.sampler import guided_sampler, useful_flops, workload_inputs
from benchmarks.steps import KINDS, denoiser_config, step_of
from scjax.nn.sharding import spread, use_every_core

_ENOUGH = 0.1  # s of timed calls of one product
_STEPS = 100


class Product(NamedTuple):
    """A matrix product: shapes of its operands, their type and that of the result, and which axes are summed over."""

    left: tuple[int, ...]
    right: tuple[int, ...]
    operands: str
    result: str
    numbers: Any

    @property
    def flops(self) -> int:
        """Multiplications and additions."""
        (summed, _), (batched, _) = self.numbers
        other = math.prod(self.right) // math.prod(self.left[axis] for axis in (*summed, *batched))
        return 2 * math.prod(self.left) * other


def products(jaxpr: Any, times: int = 1) -> Iterator[tuple[Product, int]]:
    """Every matrix product of a program and how often it runs (loops with a number of rounds known beforehand)."""
    for equation in jaxpr.eqns:
        if equation.primitive.name == "dot_general":
            left, right = (x.aval for x in equation.invars)
            numbers = equation.params["dimension_numbers"]
            yield Product(left.shape, right.shape, str(left.dtype), str(equation.outvars[0].aval.dtype), numbers), times
        rounds = equation.params["length"] if equation.primitive.name == "scan" else 1
        for inner in jax.tree.leaves(list(equation.params.values()), is_leaf=_is_program):
            if _is_program(inner):
                yield from products(getattr(inner, "jaxpr", inner), times * rounds)


def _is_program(value: Any) -> bool:
    return hasattr(value, "eqns") or hasattr(value, "jaxpr")


def seconds_alone(product: Product) -> float:
    """Least time of a product while every core works on one of its own, without what a call costs anyway."""

    def alone(a, b):
        return jax.lax.dot_general(a[0], b[0], product.numbers, preferred_element_type=product.result)[None]

    return max(_least(alone, product.left, product.right, product.operands) - _idle_call(), 0.0)


@functools.cache
def _idle_call() -> float:
    return _least(lambda a, b: jnp.zeros((1, 1)), (1,), (1,), "float32")


def _least(function: Callable[..., jax.Array], left: tuple[int, ...], right: tuple[int, ...], dtype: str) -> float:
    mesh, spec = Mesh(jax.devices(), ("core",)), PartitionSpec("core")
    operands = tuple(jnp.ones((mesh.size, *shape), dtype) for shape in (left, right))
    run = jax.jit(jax.shard_map(function, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False))
    placed = jax.device_put(operands, NamedSharding(mesh, spec))
    once = workload.best_seconds(lambda: run(*placed).block_until_ready(), 2)
    return workload.best_seconds(lambda: run(*placed).block_until_ready(), min(max(int(_ENOUGH / once), 3), 200))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.products", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", choices=KINDS, nargs="?", default="autoencoder")
    parser.add_argument("--batch", type=int, default=16, help="scenes a step (default: 16)")
    parser.add_argument("--compute", choices=["float32", "bfloat16"], default="float32")
    parser.add_argument("--sampling", action="store_true", help=f"{_STEPS} guided steps of sampling")
    args = parser.parse_args(arguments)
    if args.sampling and args.kind == "autoencoder":
        parser.error("--sampling is of denoisers: choose unconditional, text or image")
    use_every_core()
    scenes = max(64, args.batch)
    programs, work = (sampling if args.sampling else training)(args.kind, args.batch, scenes, args.compute)
    times_of: Counter[Product] = Counter()
    for program in programs:
        for product, times in products(program):
            times_of[product] += times
    seconds = {
        product: seconds_alone(product)
        for product in tqdm(times_of, "products", unit="size", leave=False, disable=None)
    }
    cores = jax.device_count()
    alone = sum(times * cores * product.flops for product, times in times_of.items()) / 1e9
    rate = alone / sum(times * seconds[product] for product, times in times_of.items())

    peak = workload.rooflines()[args.compute]
    rates = {"products alone": rate, "large product": peak}
    most = {name: value * 1e9 * scenes / work for name, value in rates.items()}  # scenes/s
    row = {
        "step": f"sampling, {args.kind}" if args.sampling else args.kind,
        "batch": args.batch,
        "compute": args.compute,
        "useful GFLOP a scene": work / scenes / 1e9,
        "sizes of products": len(times_of),
        **{f"{name} GFLOP/s": value for name, value in rates.items()},
        **{f"most scenes/s, {name}": value for name, value in most.items()},
    }
    print(workload.table([row]))
    print(json.dumps({**row, "machine": workload.machine()}))
    slowest = sorted(times_of, key=lambda product: -times_of[product] * seconds[product])[:12]
    print(
        workload.table(
            [
                {
                    "left": _shape(product.left),
                    "right": _shape(product.right),
                    "times": times_of[product],
                    "share of time": times_of[product] * seconds[product] * rate / alone,
                    "GFLOP/s": cores * product.flops / seconds[product] / 1e9,
                }
                for product in slowest
                if seconds[product] > 0
            ]
        )
    )


def training(kind: str, batch: int, scenes: int, compute: str) -> tuple[list[Any], float]:
    """What a core computes in each step of a pass over the workload, and the pass's useful FLOPs."""
    timed = step_of(kind, batch, scenes, compute)
    params = jax.eval_shape(timed.network.init, jax.random.key(0))
    gradient = jax.grad(timed.objective, has_aux=True)
    share = jax.tree.map(lambda x: x[: batch // jax.device_count()], timed.inputs)
    programs = [jax.make_jaxpr(gradient)(params, part, jax.random.key(0)).jaxpr for part in share]
    return programs, sum(timed.useful_flops(lanes, agents) for lanes, agents in workload.counts(scenes))


def sampling(kind: str, batch: int, scenes: int, compute: str) -> tuple[list[Any], float]:
    """The same of sampling."""
    config = denoiser_config(kind, compute)
    run, params = guided_sampler(config, "ddpm", _STEPS)
    parts = workload.batches(batch, scenes)
    programs = [jax.make_jaxpr(spread(run, shared=1))(params, *workload_inputs(part, kind)).jaxpr for part in parts]
    return programs, sum(useful_flops(config, kind, _STEPS, part) for part in parts)


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))


if __name__ == "__main__":
    main()
