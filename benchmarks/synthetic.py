"""How fast is the synthetic world, and do the captioner's rules match its labels? python -m benchmarks.synthetic

One core builds worlds, crops all their scenes and reads their facts by rule. Prints scenes/s of building and cropping,
without the reading (target: 100), and the share of labels that the rules match (target: 97 %).
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from tqdm import tqdm

from benchmarks.workload import machine
from scjax.data.build_options import BuildOptions
from scjax.data.local_map import simplify_graph
from scjax.data.records import make_record, sample_scene
from scjax.language.agreement import label_agreement
from scjax.language.facts import extract_facts
from scjax.synthetic.source import Worlds


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.synthetic", description=__doc__)
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--smoke", action="store_true", help="3 worlds, to see that it runs")
    args = parser.parse_args(arguments)
    source = Worlds(args.seed, 3 if args.smoke else args.worlds)
    seconds, pairs = 0.0, []
    for name in tqdm(source.names(), "worlds", disable=None):
        start = time.perf_counter()
        loaded = source.load(source.scan(name), BuildOptions(), dense=False)
        lanes = simplify_graph(loaded.graph)
        scenes = [
            sample_scene(make_record(loaded.log, lanes, loaded.index, pose, 0)[0], off_road=loaded.keep_parked)
            for pose in loaded.poses
        ]
        seconds += time.perf_counter() - start
        pairs += zip(loaded.labels or [], map(extract_facts, scenes), strict=True)
    print(machine())
    print(f"{len(pairs)} scenes of {source.count} worlds, {len(pairs) / seconds:.0f} scenes/s on one core")
    agreement = label_agreement(pairs)
    for attribute, (good, total) in agreement.items():
        print(f"{attribute:<34}{good} of {total} ({100 * good / total:.1f} %)")
    named = [agreement[attribute] for attribute in agreement if attribute != "no other event"]
    print(f"{'all labels':<34}{100 * np.sum([good for good, _ in named]) / np.sum([n for _, n in named]):.1f} %")


if __name__ == "__main__":
    main()
