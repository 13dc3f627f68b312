"""How fast is the synthetic world, and do measured attributes match its labels? python -m benchmarks.synthetic

One core builds worlds, crops all their scenes and measures their attributes. Prints scenes per CPU second of building
and cropping, without the measuring (target: 50, so that two cores make 100), and the share of labels that the
attributes match (target: 97 %).
"""

from __future__ import annotations

import argparse
import collections
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.workload import machine
from scjax.data.build_options import BuildOptions
from scjax.data.local_map import simplify_graph
from scjax.data.records import make_record, sample_scene
from scjax.language.attributes.table import measure_attributes
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
        start = time.process_time()
        loaded = source.load(source.scan(name), BuildOptions(), dense=False)
        lanes = simplify_graph(loaded.graph)
        scenes = [
            sample_scene(make_record(loaded.log, lanes, loaded.index, pose, 0)[0], off_road=loaded.keep_parked)
            for pose in loaded.poses
        ]
        seconds += time.process_time() - start
        pairs += zip(loaded.labels or [], map(measure_attributes, scenes), strict=True)
    print(machine())
    print(f"{len(pairs)} scenes of {source.count} worlds, {len(pairs) / seconds:.0f} scenes per CPU second")
    matches: dict[str, list[bool]] = collections.defaultdict(list)
    for label, measured in pairs:
        for name, value in label_matches(label, measured):
            matches[name].append(value)
    for name, values in sorted(matches.items()):
        print(f"{name:<34}{sum(values)} of {len(values)} ({100 * np.mean(values):.1f} %)")
    named = [value for name, values in matches.items() if name != "no other event" for value in values]
    print(f"{'all labels':<34}{100 * np.mean(named):.1f} %")


def label_matches(label: Mapping[str, Any], measured: Mapping[str, Any]) -> Iterator[tuple[str, bool]]:
    """Label of a scene by construction -> whether the attribute is measured so.

    Args:
      label: the JSON form of ``scjax.synthetic.labels.SceneLabel``.
    """
    if label["layout"] is not None:
        yield f"layout {label['layout']}", label["layout"] in measured["layout"]
    if label["signal"] is not None:
        colors = {"red", "yellow", "green"} & set(measured["signal"])
        yield f"signal {label['signal'] or 'none'}", colors == {label["signal"]} - {""}
    if label["event"] is not None:
        yield f"event {label['event']}", label["event"] in measured["event"]
    yield "no other event", not set(measured["event"]) - {label["event"]}


if __name__ == "__main__":
    main()
