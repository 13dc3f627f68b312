"""Are the towns sound where a scene cannot show it? python -m benchmarks.towns --maps FOLDER --towns Town01 Town03

Looks at whole lanes, which scenes cut at their border, and at motion over time. Prints for each simulation: ways
through junctions that cross while both are green (of all that cross); ways straight on from one place that are red and
green at once (of all such pairs); accelerations of vehicles [m/s²]; and logs, records and crops a second, by the
time of one core. Needs SUMO (``benchmarks/sumo``, or the extra ``traffic``).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scjax.data.build_options import BuildOptions
from scjax.data.local_map import simplify_graph
from scjax.data.records import decode_record, encode_record, make_record, sample_scene
from scjax.scene import AgentType, Crop, MapLane, Signal, load_log
from scjax.scene.angles import wrap_to_pi
from scjax.towns.source import TownRun, Towns, make_towns
from scjax.towns.town_traffic import TownTraffic, load_traffic

_CROSSING = np.deg2rad(22.0)
_SAME_LEVEL = 2.5  # m
_STRAIGHT_ON = np.deg2rad(20.0)
_ONE_PLACE = 5.0  # m


def conflicting_greens(lanes: dict[str, MapLane], traffic: TownTraffic) -> tuple[int, int]:
    """Pairs of ways that cross and are green at once, and all pairs that cross."""
    ways = [lanes[name] for name in traffic.signal_lanes]
    conflicts = total = 0
    for i, first in enumerate(ways):
        for j, second in enumerate(ways[:i]):
            if _boxes_meet(first.points, second.points) and _cross(first.points, second.points):
                total += 1
                both = (traffic.signal_states[[i, j]] == Signal.GO).all(0)
                conflicts += bool(both.any())
    return conflicts, total


def split_signals(lanes: dict[str, MapLane], traffic: TownTraffic) -> tuple[int, int]:
    """Pairs of ways straight on from one place that are red and green at once, and all pairs of such ways."""
    ways = [lanes[name] for name in traffic.signal_lanes]
    straight = [abs(wrap_to_pi(_heading(lane, -1) - _heading(lane))) < _STRAIGHT_ON for lane in ways]
    split = total = 0
    for i, first in enumerate(ways):
        for j, second in enumerate(ways[:i]):
            near = np.hypot(*(first.points[0] - second.points[0])[:2]) < _ONE_PLACE
            along = abs(wrap_to_pi(_heading(first) - _heading(second))) < _STRAIGHT_ON
            if near and along and straight[i] and straight[j]:
                total += 1
                states = traffic.signal_states[[i, j]]
                red, green = states == Signal.STOP, states == Signal.GO
                split += bool(((red[0] & green[1]) | (red[1] & green[0])).any())
    return split, total


def _heading(lane: MapLane, segment: int = 0) -> float:
    """Direction of a segment of a lane [rad]."""
    step = np.diff(lane.points, axis=0)[segment]
    return float(np.arctan2(step[1], step[0]))


def _boxes_meet(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the rectangles around two polylines meet."""
    return bool(((a.min(0) <= b.max(0)) & (b.min(0) <= a.max(0)))[:2].all())


def _cross(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two polylines cross at one height."""
    p, q = a[:-1, None], b[None, :-1]
    r, s = np.diff(a, axis=0)[:, None], np.diff(b, axis=0)[None]
    denominator = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    lengths = np.hypot(r[..., 0], r[..., 1]) * np.hypot(s[..., 0], s[..., 1])
    steep = np.abs(denominator) > np.sin(_CROSSING) * lengths
    denominator = np.where(steep, denominator, 1.0)
    w = q - p
    t = (w[..., 0] * s[..., 1] - w[..., 1] * s[..., 0]) / denominator
    u = (w[..., 0] * r[..., 1] - w[..., 1] * r[..., 0]) / denominator
    level = np.abs(p[..., 2] + t * r[..., 2] - q[..., 2] - u * s[..., 2]) < _SAME_LEVEL
    return bool((steep & level & (t > 0) & (t < 1) & (u > 0) & (u < 1)).any())


def accelerations(traffic: TownTraffic) -> np.ndarray:
    """Of all vehicles at all steps [m/s²], by their positions."""
    rows = []
    for k in np.flatnonzero(traffic.types == AgentType.VEHICLE):
        track = traffic.positions[traffic.offsets[k] : traffic.offsets[k + 1], :2]
        rows.append(np.hypot(*np.diff(track, 2, axis=0).T) / 0.01)
    return np.concatenate([np.zeros(1), *rows])


class Speed(NamedTuple):
    """On one core, by its own time: logs and records that are cut from a simulation, crops of records, a second."""

    logs: float
    records: float
    crops: float


def speed(run: TownRun, logs: int) -> Speed:
    """Of the first ``logs`` logs; every record is cropped in all three ways."""
    towns = Towns((run,))
    names, records = towns.names()[:logs], []
    towns.load(towns.scan(names[0]), BuildOptions(), dense=True)  # reads the map
    start = time.process_time()
    for name in names:
        posed = towns.load(towns.scan(name), BuildOptions(), dense=True)
        lanes = simplify_graph(posed.graph)
        records += [encode_record(make_record(posed.log, lanes, posed.index, pose, 0)[0]) for pose in posed.poses]
    cutting = time.process_time() - start
    start = time.process_time()
    for record in records:
        decoded = decode_record(record)
        for crop in Crop:
            sample_scene(decoded, crop)
    cropping = time.process_time() - start
    return Speed(len(names) / cutting, len(records) / cutting, len(Crop) * len(records) / cropping)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.towns", description=__doc__)
    parser.add_argument("--maps", type=Path, required=True, help="folder of OpenDRIVE files")
    parser.add_argument("--towns", nargs="*", default=(), help="names of maps; all by default")
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--logs", type=int, default=20, help="logs that are timed")
    args = parser.parse_args(arguments)
    source = make_towns(args.maps, args.towns, runs=args.runs, seconds=args.seconds, seed=args.seed)
    print(
        "| simulation | objects | logs | conflicting greens | split signals | acceleration, 99 %, 99.99 %, most |"
        " logs/s | records/s | crops/s |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for run in source.runs:
        traffic = load_traffic(Path(run.traffic_file))
        lanes = {lane.id: lane for lane in load_log(run.map_file).lanes}
        greens, splits = ("{} of {}".format(*count(lanes, traffic)) for count in (conflicting_greens, split_signals))
        values = ", ".join(f"{v:.1f}" for v in np.quantile(accelerations(traffic), (0.99, 0.9999, 1.0)))
        rates = "{:.0f} | {:.0f} | {:.0f}".format(*speed(run, args.logs)) if run.count else "- | - | -"
        name = f"{run.town}/{run.number}"
        print(f"| {name} | {len(traffic.names)} | {run.count} | {greens} | {splits} | {values} | {rates} |", flush=True)


if __name__ == "__main__":
    main()
