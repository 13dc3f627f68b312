"""How fast is a training step? python -m benchmarks.train_step [autoencoder|unconditional|text|image] --batch 16

Prints scenes/s (real scenes of the workload), GFLOP/s of useful work and its share of the measured rooflines, compile
time and peak memory. ``benchmarks.peer`` compares with the official release.
"""

from __future__ import annotations

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory

    keep_memory()

import argparse
import json
import time
from collections.abc import Callable

import jax
import numpy as np

from benchmarks import workload
from benchmarks.steps import KINDS, Step, step_of
from scjax.nn.sharding import use_every_core
from scjax.train.flat_params import FlatParams
from scjax.train.optimizer import adamw
from scjax.train.step import TrainingStep, initial_state


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.train_step", description=__doc__)
    parser.add_argument("kind", choices=KINDS, nargs="?", default="autoencoder")
    parser.add_argument("--batch", type=int, default=16, help="scenes a step (default: 16)")
    parser.add_argument("--scenes", type=int, help="scenes of the workload (default: 64, a batch at least)")
    parser.add_argument("--compute", choices=["float32", "bfloat16"], default="float32")
    parser.add_argument("--repeats", type=int, default=3, help="timed passes over the workload")
    parser.add_argument("--smoke", action="store_true", help="one small batch, to see that it runs")
    args = parser.parse_args(arguments)
    use_every_core()
    scenes = args.batch if args.smoke else args.scenes or max(64, args.batch)
    if scenes % args.batch:
        parser.error(f"--scenes {scenes} are no whole number of batches of {args.batch}")
    timed = step_of(args.kind, args.batch, scenes, args.compute)
    run = training_pass(timed, args.batch)
    start = time.perf_counter()
    run()
    first_pass = time.perf_counter() - start
    seconds = workload.best_seconds(run, 1 if args.smoke else args.repeats)
    programs = {tuple(leaf.shape for leaf in jax.tree.leaves(batch)) for batch in timed.inputs}
    work = sum(timed.useful_flops(lanes, agents) for lanes, agents in workload.counts(scenes)) / seconds / 1e9
    roofs = workload.rooflines()
    row = {
        "step": args.kind,
        "batch": args.batch,
        "scenes": scenes,
        "compute": args.compute,
        "scenes/s": scenes / seconds,
        "GFLOP/s": work,
        **{f"share of {name}": work / roof for name, roof in roofs.items()},
        "programs": len(programs),
        "compile s": first_pass - seconds,
        "peak GB": workload.peak_memory_gb(),
    }
    print(workload.table([row]))
    print(json.dumps({**row, "rooflines": roofs, "machine": workload.machine()}))


def training_pass(timed: Step, batch_size: int) -> Callable[[], None]:
    """One pass over the workload: steps of a training itself, with their moving average and use of every core."""
    optimizer = adamw(learning_rate=1e-4, steps=1000)
    params = timed.network.init(jax.random.key(0))
    groups, index = FlatParams.of(params), np.arange(batch_size, dtype=np.uint32)
    step = TrainingStep(timed.objective, groups, optimizer, ema_decay=0.999, seed=1, batch_size=batch_size)
    state = initial_state(params, groups, optimizer)

    def run() -> None:
        nonlocal state
        for batch in timed.inputs:
            state, metrics = step(state, batch, index)
            jax.block_until_ready(metrics)

    return run


if __name__ == "__main__":
    main()
