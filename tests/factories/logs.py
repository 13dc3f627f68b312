"""A small log made by hand."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import AgentType, LaneNeighbor, Log, LogMetadata, MapLane, Signal


def example_log(**changes) -> Log:
    """Ten steps of 0.1 s: an ego, a van behind it on the left lane, a pedestrian that is seen from step 4 on.

    Lane "a" leads into "b"; "c" runs to the left of both. Lane "b" has a signal that turns from GO to STOP.
    """
    steps = np.arange(10)
    valid = np.ones((3, 10), bool)
    valid[2, :4] = False
    positions = np.zeros((3, 10, 3))
    positions[0] = np.stack([5000 + steps, np.full(10, 200.0), np.full(10, 10.8)], -1)
    positions[1] = positions[0] + [-9.0, 3.5, 0.2]
    positions[2, 4:] = [5012.0, 196.0, np.nan]
    velocities = np.zeros((3, 10, 2))
    velocities[:2, :, 0] = 10.0
    log = Log(
        timestamps=100.0 + 0.1 * steps,
        object_ids=("ego", "van", "pedestrian"),
        object_types=np.array([AgentType.VEHICLE, AgentType.VEHICLE, AgentType.PEDESTRIAN]),
        valid=valid,
        positions=positions,
        headings=np.zeros((3, 10)),
        velocities=velocities,
        sizes=np.array([[4.5, 2.0, 1.6], [6.0, 2.4, 2.0], [0.8, 0.8, np.nan]]),
        ego_index=0,
        signal_lane_ids=("b",),
        signal_states=np.where(steps < 6, Signal.GO, Signal.STOP)[None],
        signal_positions=np.array([[5020.0, 200.0, np.nan]]),
        lanes=(
            straight_lane("a", 4950, 5020, 200, successors=("b",), left_neighbors=(LaneNeighbor("c", 0, 140, 0, 140),)),
            straight_lane("b", 5020, 5060, 200, predecessors=("a",), left_neighbors=(LaneNeighbor("c"),)),
            straight_lane("c", 4950, 5060, 203.5, z=np.nan),
        ),
        has_topology=True,
        metadata=LogMetadata(domain="village", scene_id="7", location_cluster="here", source_file="example"),
    )
    return dataclasses.replace(log, **changes)


def straight_lane(name: str, start: float, end: float, y: float, z: float = 10.0, **links) -> MapLane:
    """A lane along x with points 0.5 m apart."""
    x = np.linspace(start, end, int(2 * (end - start)) + 1)
    points = np.stack([x, np.full(len(x), float(y)), np.full(len(x), float(z))], -1)
    return MapLane(name, "surface_street", points, **links)
