"""Do our reader and SUMO's netconvert find the same lanes in OpenDRIVE files?

python -m benchmarks.opendrive --sumo ENV FILES, where ENV is an environment with SUMO (`bash benchmarks/sumo/install.sh
ENV`). Compared are lanes for cars by road and lane id: their number, their length outside of junctions, and which lane
leads into which one, through junctions too. Lane types that only netconvert takes for lanes of cars are left out and
named.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from scjax.data.readers.opendrive import read_road_map
from scjax.scene.map_lane import NO_CAR_LANE_TYPES

OPTIONS = {
    "output.original-names": "true",
    "opendrive.internal-shapes": "true",
    "opendrive.curve-resolution": "1",
    "opendrive.min-width": "0.1",  # by default lanes begin where they are 1.8 m wide
    "geometry.min-dist": "0",
}
OTHER_TYPES = ("parking", "bidirectional", "stop", "border", "restricted", "biking", "special1", "special2", "special3")
"""Types of lanes that netconvert lets cars use too, though no way leads through them."""

ALLOWED = 2.0  # percent


class Network(NamedTuple):
    """Lanes for cars outside of junctions as "road_lane".

    Attributes:
      lengths: of each [m].
      connections: pairs that follow each other, also through a junction.
      others: lanes of types that cars do not drive through, by type.
    """

    lengths: dict[str, float]
    connections: set[tuple[str, str]]
    others: Counter[str]


def read_ours(path: Path) -> Network:
    """The network by our reader."""
    road_map = read_road_map(path)
    lengths: dict[str, float] = defaultdict(float)
    connections: set[tuple[str, str]] = set()
    for key, line in road_map.lines.items():
        name = f"{key.road}_{key.lane}"
        if road_map.lane_types[key] not in NO_CAR_LANE_TYPES and not line.in_junction:
            lengths[name] += line.length
            front, seen = [key], {key}
            while front:
                for following in road_map.successors.get(front.pop(), ()):
                    target = f"{following.road}_{following.lane}"
                    if not road_map.lines[following].in_junction:
                        connections.add((name, target))
                    elif following not in seen:
                        seen.add(following)
                        front.append(following)
    return Network(dict(lengths), {pair for pair in connections if pair[0] != pair[1]}, Counter())


def read_netconvert(path: Path, sumo: Path) -> Network | str:
    """The network by netconvert, or why it refuses the file."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, "net.xml")
        options = [f"--{name}={value}" for name, value in OPTIONS.items()]
        (home,) = sumo.glob("lib/python*/site-packages/sumo")
        result = subprocess.run(
            [str(sumo / "bin" / "netconvert"), "--opendrive-files", str(path), "--output-file", str(out), *options],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"SUMO_HOME": str(home)},
        )
        if result.returncode:
            errors = [line for line in result.stderr.splitlines() if line.startswith("Error")]
            return (errors or ["it gives no reason"])[0]
        return _network_of(ElementTree.parse(out).getroot())


def _network_of(root: ElementTree.Element) -> Network:
    lengths: dict[str, float] = defaultdict(float)
    names: dict[tuple[str, str], str] = {}
    inner: dict[str, float] = {}
    others: Counter[str] = Counter()
    for edge in root.iter("edge"):
        for lane in edge.iter("lane"):
            points = np.array([[float(v) for v in point.split(",")[:2]] for point in lane.get("shape", "").split()])
            length = float(np.hypot(*np.diff(points, axis=0).T).sum())
            word = lane.get("type", "driving")
            if edge.get("function") is not None:
                inner[lane.get("id", "")] = length
            elif word in OTHER_TYPES:
                others[word] += 1
            else:
                name = next((item.get("value", "") for item in lane.iter("param") if item.get("key") == "origId"), "")
                names[edge.get("id", ""), lane.get("index", "")] = name
                lengths[name] += length
    connections, seams = set(), {}
    for item in root.iter("connection"):
        ends = [(item.get(end, ""), item.get(f"{end}Lane", "")) for end in ("from", "to")]
        if all(end in names for end in ends) and item.get("dir") != "t":
            pair = names[ends[0]], names[ends[1]]
            connections.add(pair)
            if pair[0].rpartition("_")[0] == pair[1].rpartition("_")[0]:
                seams[ends[0]] = pair[0], inner.get(item.get("via", ""), 0.0)
    for name, length in seams.values():  # between two sections of a road netconvert cuts lanes off
        lengths[name] += length
    return Network(dict(lengths), {pair for pair in connections if pair[0] != pair[1]}, others)


def compare(path: Path, sumo: Path) -> tuple[str, bool]:
    """A row of the table, and whether lanes and lengths agree within 2 %."""
    theirs = read_netconvert(path, sumo)
    ours = read_ours(path)
    if isinstance(theirs, str):
        lanes, km = len(ours.lengths), sum(ours.lengths.values()) / 1000
        return f"| {path.stem} | {lanes} / - | {km:.2f} / - | | | netconvert refuses it: {theirs} |", True
    ours_km, theirs_km = (sum(table.values()) / 1000 for table in (ours.lengths, theirs.lengths))
    percent = 100 * (ours_km - theirs_km) / theirs_km if theirs_km else 0.0
    counts = abs(len(ours.lengths) - len(theirs.lengths)) / max(len(theirs.lengths), 1) * 100
    missing = len(theirs.lengths.keys() - ours.lengths.keys())
    notes = [f"{number} lanes of type {word} left out" for word, number in sorted(theirs.others.items())]
    notes += [f"{missing} lanes of netconvert missing"] if missing else []
    both = len(ours.connections & theirs.connections)
    links = f"{len(ours.connections)} / {len(theirs.connections)}, {both} in both"
    lanes = f"{len(ours.lengths)} / {len(theirs.lengths)}"
    row = (
        f"| {path.stem} | {lanes} | {ours_km:.2f} / {theirs_km:.2f} | {percent:+.2f} % | {links} | {'; '.join(notes)} |"
    )
    return row, abs(percent) <= ALLOWED and counts <= ALLOWED


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.opendrive", description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="OpenDRIVE files")
    parser.add_argument("--sumo", type=Path, required=True, metavar="ENV", help="environment with SUMO")
    args = parser.parse_args(arguments)
    print("| file | lanes, ours / SUMO | km, ours / SUMO | difference | connections | notes |")
    print("| --- | --- | --- | --- | --- | --- |")
    outside = []
    for path in args.files:
        row, agrees = compare(path, args.sumo)
        print(row, flush=True)
        outside += [] if agrees else [path.stem]
    print(f"\nmore than {ALLOWED:g} % apart: {', '.join(outside) or 'none'}")


if __name__ == "__main__":
    main()
