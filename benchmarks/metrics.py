"""How long does it take to measure 10,000 scenes? python -m benchmarks.metrics

Every metric that needs no network (scjax.metrics.measure: both modes of the distributions, overlaps, matches, average
precision, control) on tiles of the procedural world, each moved and turned a little, against another such set: the
wanted time is 60 s on 2 cores and the wanted memory 2 GB. Bootstrap intervals and floors come apart.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import multiprocessing
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.workload import machine, peak_memory_gb
from scjax.data import records
from scjax.data.build import build
from scjax.data.procedural import write_scenes
from scjax.metrics import measure as metrics
from scjax.metrics.measured import Measured, merged
from scjax.metrics.tally import Tally
from scjax.scene import Layout, Scene

CHUNK = 250


def tiles(folder: str, seed: int, start: int, stop: int) -> tuple[list[Scene], list[str]]:
    """Scenes ``start`` to ``stop`` of a population: records in turn, each from a pose of its own nearby."""
    source = records.source(folder, "train")
    made, places = [], []
    for k in range(start, stop):
        rng = np.random.default_rng([seed, k])
        record = records.decode(source[k % len(source)])
        dx, dy = rng.uniform(-2, 2, 2)
        made.append(records.sample_scene(record, Layout.CENTRED, dx, dy, rng.uniform(-0.15, 0.15)))
        places.append(record.cluster)
    return made, places


def chunk(folder: str, start: int, stop: int) -> tuple[Measured, Measured, float]:
    """Generated and reference scenes of a part, and the seconds that measuring them took."""
    (generated, places), (reference, _) = (tiles(folder, seed, start, stop) for seed in (1, 2))
    begin = time.perf_counter()
    ours, theirs = metrics.measure(generated, places, reference), metrics.measure(reference, places)
    return ours, theirs, time.perf_counter() - begin


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.metrics", description=__doc__)
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--smoke", action="store_true", help="500 scenes, to see that it runs")
    args = parser.parse_args(arguments)
    scenes = 500 if args.smoke else args.scenes
    with tempfile.TemporaryDirectory() as folder:
        write_scenes(Path(folder) / "scenes", 8 if args.smoke else 60, progress=False)
        build(Path(folder) / "scenes", Path(folder) / "records", workers=args.workers)
        parts = [(str(Path(folder) / "records"), k, min(k + CHUNK, scenes)) for k in range(0, scenes, CHUNK)]
        context = multiprocessing.get_context("spawn")
        with concurrent.futures.ProcessPoolExecutor(args.workers, mp_context=context) as pool:
            begin = time.perf_counter()
            found = list(pool.map(chunk, *zip(*parts, strict=True)))
            measured = time.perf_counter() - begin
    ours, theirs = (merged([part[side] for part in found]) for side in (0, 1))
    del found
    begin = time.perf_counter()
    values = {
        **{
            f"{mode}/{name}": value
            for mode in metrics.MODES
            for name, value in metrics.distribution_values(ours.tally.total, theirs.tally.total, mode).items()
        },
        **metrics.scene_values(ours.tally.total), **metrics.match_values(ours.tally.total),
        **metrics.precision_values(ours), **metrics.control_values(ours, theirs),
    }  # fmt: skip
    summarised = time.perf_counter() - begin
    begin = time.perf_counter()
    _strict(ours.tally).intervals(_strict(theirs.tally), lambda a, b: metrics.distribution_values(a, b, "strict"))
    bootstrap = time.perf_counter() - begin
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    row = {
        "scenes": scenes, "workers": args.workers, "seconds": measured + summarised, "measured s": measured,
        "summarised s": summarised, "ms a pair of scenes": 1000 * measured * args.workers / scenes,
        "bootstrap of one table s": bootstrap, "peak GB": peak_memory_gb(), "peak GB of a worker": children,
        "values": len(values),
    }  # fmt: skip
    print(json.dumps({**row, "machine": machine()}, indent=1))


def _strict(tally: Tally) -> Tally:
    """Only what the strict table needs."""
    return Tally(
        {
            cluster: {name: value for name, value in sums.items() if name.startswith("strict/")}
            for cluster, sums in tally.clusters.items()
        }
    )


if __name__ == "__main__":
    main()
