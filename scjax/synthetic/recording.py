"""A world as a recording: the ``Log`` that readers of data sets return too."""

from __future__ import annotations

import hashlib

import numpy as np

from scjax.scene import LaneNeighbor, Log, LogMetadata, MapLane, Signal
from scjax.synthetic.actors import concatenate_actors
from scjax.synthetic.ground import Ground
from scjax.synthetic.network import Network
from scjax.synthetic.setting import VERSION
from scjax.synthetic.stage import moment_times
from scjax.synthetic.world import World


def to_log(world: World) -> Log:
    """The log of a world; its steps are the moments. Every agent of every moment is an object of its own."""
    flip = -1.0 if world.mirrored else 1.0
    counts = [len(moment) for moment in world.moments]
    agents = concatenate_actors(list(world.moments))
    num_objects, num_steps = len(agents), len(counts)
    valid = np.zeros((num_objects, num_steps), bool)
    valid[np.arange(num_objects), np.repeat(np.arange(num_steps), counts)] = True
    ground = world.ground.height(agents.positions) + agents.level
    positions = np.column_stack([agents.positions * np.array([1.0, flip]), ground + agents.sizes[:, 2] / 2])
    headings = flip * agents.headings
    velocities = agents.speeds[:, None] * np.stack([np.cos(headings), np.sin(headings)], -1)
    signals = np.stack(world.signals, 1)
    signal_lanes = np.flatnonzero((signals != Signal.UNKNOWN).any(1))
    return Log(
        timestamps=moment_times(num_steps),
        object_ids=tuple(map(str, range(num_objects))),
        object_types=agents.types.astype(int),
        valid=valid,
        positions=np.where(valid[..., None], positions[:, None], 0.0),
        headings=np.where(valid, headings[:, None], 0.0),
        velocities=np.where(valid[..., None], velocities[:, None], 0.0),
        sizes=agents.sizes,
        signal_lane_ids=tuple(str(lane) for lane in signal_lanes),
        signal_states=signals[signal_lanes].astype(np.int8),
        signal_positions=np.full((len(signal_lanes), 3), np.nan),
        lanes=map_lanes(world.net, world.ground, flip),
        has_topology=True,
        metadata=world_metadata(world.name, world.domain),
    )


def object_index(world: World, moment: int, agent: int) -> int:
    """Index in ``to_log`` of an agent of a moment."""
    return sum(len(world.moments[m]) for m in range(moment)) + agent


def world_metadata(name: str, domain: str) -> LogMetadata:
    """Where the logs of a world come from."""
    return LogMetadata(
        domain=domain,
        scene_id=name,
        location_cluster=name,
        variant="synthetic",
        source_file=f"synthetic world {name}",
        source_sha256=hashlib.sha256(f"{VERSION} {name}".encode()).hexdigest(),
    )


def map_lanes(net: Network, ground: Ground, flip: float) -> tuple[MapLane, ...]:
    """The lanes of a network as a map; ``flip`` -1 mirrors it for left-hand traffic."""
    lanes = net.lanes
    predecessors: list[list[str]] = [[] for _ in lanes]
    for k, lane in enumerate(lanes):
        for successor in lane.successors:
            predecessors[successor].append(str(k))
    map_lanes = []
    for k, lane in enumerate(lanes):
        z = ground.height(lane.points) + lane.height
        points = np.column_stack([lane.points * np.array([1.0, flip]), z])
        sides = [() if other is None else (LaneNeighbor(str(other)),) for other in (lane.left, lane.right)]
        left, right = sides if flip > 0 else sides[::-1]
        successors = tuple(str(j) for j in lane.successors)
        map_lanes.append(MapLane(str(k), lane.subtype, points, tuple(predecessors[k]), successors, left, right))
    return tuple(map_lanes)
