"""How long does it take to measure 10,000 scenes? python -m benchmarks.metrics

Times every metric without a network (scjax.metrics.measure: both modes of the distributions, overlaps, matches, average
precision, control) between two sets of synthetic tiles, each tile shifted and rotated a little. As in scjax.evaluate,
scenes are read from npz files, part by part, in processes. Targets: 60 s on 2 cores, 2 GB of memory. Bootstrap
intervals and floors are timed separately.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.workload import machine, peak_memory_gb
from scjax.data import records
from scjax.data.build import build_records
from scjax.evaluate.population import PART_SIZE, Population, measure_populations
from scjax.evaluate.sources import NpzScenes
from scjax.metrics import measure as metrics
from scjax.metrics.cluster_sums import ClusterSums
from scjax.scene import Crop, stack
from scjax.scene.io import save_npz
from scjax.synthetic.source import Worlds


def write_tiles(folder: Path, out: Path, seed: int, count: int) -> None:
    """A population in npz files: records in turn, each from a pose of its own nearby."""
    out.mkdir()
    source = records.open_records(folder, "train")
    for start in range(0, count, PART_SIZE):
        scenes = []
        for k in range(start, min(start + PART_SIZE, count)):
            rng = np.random.default_rng([seed, k])
            dx, dy = rng.uniform(-2, 2, 2)
            record = records.decode_record(source[k % len(source)])
            scenes.append(records.sample_scene(record, Crop.CENTERED, dx, dy, rng.uniform(-0.15, 0.15)))
        save_npz(stack(scenes), out / f"{start:06d}.npz")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.metrics", description=__doc__)
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--smoke", action="store_true", help="500 scenes, to see that it runs")
    args = parser.parse_args(arguments)
    scenes = 500 if args.smoke else args.scenes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build_records(Worlds(0, 8 if args.smoke else 200), folder / "records", workers=args.workers)
        for seed, kind in enumerate(("generated", "reference")):
            write_tiles(folder / "records", folder / kind, 1 + seed, scenes)
        generated, reference = (NpzScenes(str(folder / kind)) for kind in ("generated", "reference"))
        rows = [Population("generated", generated, reference, range(scenes)), Population("reference", reference)]
        begin = time.perf_counter()
        stats = measure_populations(rows, folder / "measured", workers=args.workers)
        took = time.perf_counter() - begin
    assert stats is not None
    ours, theirs = stats
    begin = time.perf_counter()
    values = {
        **{
            f"{mode}/{name}": value
            for mode in metrics.MODES
            for name, value in metrics.distribution_values(
                ours.cluster_sums.total, theirs.cluster_sums.total, mode
            ).items()
        },
        **metrics.scene_values(ours.cluster_sums.total),
        **metrics.match_values(ours.cluster_sums.total),
        **metrics.precision_values(ours),
        **metrics.control_values(ours, theirs),
    }
    summarised = time.perf_counter() - begin
    begin = time.perf_counter()
    _strict(ours.cluster_sums).intervals(
        _strict(theirs.cluster_sums), lambda a, b: metrics.distribution_values(a, b, "strict")
    )
    bootstrap = time.perf_counter() - begin
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    row = {
        "scenes": scenes,
        "workers": args.workers,
        "seconds": took + summarised,
        "measured s": took,
        "summarised s": summarised,
        "ms a pair of scenes": 1000 * took * args.workers / scenes,
        "bootstrap of one table s": bootstrap,
        "peak GB": peak_memory_gb(),
        "peak GB of a worker": children,
        "values": len(values),
    }
    print(json.dumps({**row, "machine": machine()}, indent=1))


def _strict(cluster_sums: ClusterSums) -> ClusterSums:
    """Only what the strict table needs."""
    return ClusterSums(
        {
            cluster: {name: value for name, value in sums.items() if name.startswith("strict/")}
            for cluster, sums in cluster_sums.clusters.items()
        }
    )


if __name__ == "__main__":
    main()
