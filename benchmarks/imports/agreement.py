"""Our lanes beside those of other libraries."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from benchmarks.opendrive import read_netconvert, read_ours
from scjax.scene import Log
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length

ALLOWED = 2.0  # percent


def consumer_results(env: Path, name: str, paths: list[Path]) -> dict[str, Any]:
    """What a library finds in files, by path: one process for each, since a library may crash."""
    results: dict[str, Any] = {}
    for path in paths:
        command = [str(env / "bin" / "python"), str(Path(__file__).with_name("consumers.py")), name, str(path)]
        process = subprocess.run(command, capture_output=True, text=True, check=False)
        crash = {str(path): {"error": f"it ends with status {process.returncode}"}}
        results |= json.loads(process.stdout) if process.returncode == 0 else crash
    return results


def agreement(log: Log, theirs: dict[str, Any]) -> dict[str, Any]:
    """Numbers of lanes, lengths [m] and connections of both, and the largest difference of one lane [percent]."""
    ours = {lane.id: float(cumulative_length(lane.points)[-1]) for lane in log.lanes}
    driven = {lane.id for lane in log.lanes if lane.lane_type not in NO_CAR_LANE_TYPES}
    links = {(lane.id, other) for lane in log.lanes for other in lane.successors if {lane.id, other} <= driven}
    row: dict[str, Any] = {"lanes": len(ours), "length": sum(ours.values()), "connections": len(links)}
    if "error" in theirs:
        return row | {"their_error": theirs["error"]}
    other = theirs["lanes"]
    worst = max((abs(ours[key] - value) / max(value, 1.0) for key, value in other.items() if key in ours), default=0.0)
    their_links = {(one, two) for one, two in theirs["connections"] if {one, two} <= driven}
    return row | {
        "their_lanes": len(other),
        "their_length": sum(other.values()),
        "their_connections": len(their_links),
        "both_connections": len(links & their_links),
        "same_ids": ours.keys() == other.keys(),
        "worst_lane": 100 * worst,
        "their_seconds": round(theirs["seconds"], 2),
    }


def opendrive_agreement(path: Path, sumo: Path) -> dict[str, Any]:
    """As ``agreement``, of lanes for cars outside of junctions by road and lane id; the library is netconvert."""
    ours, theirs = read_ours(path), read_netconvert(path, sumo)
    row: dict[str, Any] = {
        "lanes": len(ours.lengths),
        "length": sum(ours.lengths.values()),
        "connections": len(ours.connections),
    }
    if isinstance(theirs, str):
        return row | {"their_error": theirs}
    return row | {
        "their_lanes": len(theirs.lengths),
        "their_length": sum(theirs.lengths.values()),
        "their_connections": len(theirs.connections),
        "both_connections": len(ours.connections & theirs.connections),
        "same_ids": ours.lengths.keys() == theirs.lengths.keys(),
    }


def agrees(row: dict[str, Any]) -> bool:
    """Whether numbers and total lengths of lanes agree within 2 %."""
    pairs = [(row["lanes"], row["their_lanes"]), (row["length"], row["their_length"])]
    return all(abs(ours - theirs) <= ALLOWED / 100 * max(theirs, 1e-9) for ours, theirs in pairs)
