"""Logs with traffic that moves, for metrics of motion."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import NO_EGO, AgentType, Log, MapLane

DT = 0.1


def straight_log(
    *tracks: tuple[float, float, float, float],
    steps: int = 41,
    types: list[AgentType] | None = None,
    lanes: tuple[MapLane, ...] | None = None,
    signal: np.ndarray | None = None,
) -> Log:
    """Objects of 4 m x 2 m that drive straight on: (x, y, heading in degrees, speed), on a road along x.

    Args:
      signal: states of a signal at x = 20 m of that road [steps].
    """
    time = np.arange(steps) * DT
    x, y, degrees, speed = (np.array(column, float)[:, None] for column in zip(*tracks, strict=True))
    turn = np.deg2rad(degrees)
    velocity = np.stack([np.cos(turn) * speed, np.sin(turn) * speed], -1)
    positions = np.zeros((len(tracks), steps, 3))
    positions[..., :2] = np.stack([x, y], -1) + velocity * time[:, None]
    return Log(
        timestamps=time,
        object_ids=tuple(f"object {k}" for k in range(len(tracks))),
        object_types=np.array([AgentType.VEHICLE] * len(tracks) if types is None else types, int),
        valid=np.ones((len(tracks), steps), bool),
        positions=positions,
        headings=np.broadcast_to(turn, (len(tracks), steps)).copy(),
        velocities=np.broadcast_to(velocity, (len(tracks), steps, 2)).copy(),
        sizes=np.tile([4.0, 2.0, 1.5], (len(tracks), 1)),
        ego_index=0,
        signal_lane_ids=() if signal is None else ("b",),
        signal_states=np.zeros((0, steps), int) if signal is None else np.asarray(signal, int)[None],
        signal_positions=np.zeros((0, 3)) if signal is None else np.full((1, 3), np.nan),
        lanes=(road("a", -200, 20), road("b", 20, 300)) if lanes is None else lanes,
        has_topology=True,
    )


def road(name: str, start: float, end: float, y: float = 0.0) -> MapLane:
    """A straight lane along x."""
    x = np.linspace(start, end, max(2, int(end - start) // 5))
    return MapLane(name, "surface_street", np.stack([x, np.full(len(x), y), np.zeros(len(x))], -1))


def traffic_log(seed: int, objects: int = 12, steps: int = 41) -> Log:
    """Vehicles and people that start anywhere, turn and change their speed, some seen for a part of the time."""
    rng = np.random.default_rng(seed)
    speed = np.maximum(rng.uniform(0, 12, (objects, 1)) + np.cumsum(rng.normal(0, 0.3, (objects, steps)), 1), 0.0)
    heading = rng.uniform(-np.pi, np.pi, (objects, 1)) + np.cumsum(rng.normal(0, 0.02, (objects, steps)), 1)
    velocity = np.stack([np.cos(heading) * speed, np.sin(heading) * speed], -1)
    positions = np.zeros((objects, steps, 3))
    positions[..., :2] = rng.uniform(-60, 60, (objects, 1, 2)) + np.cumsum(velocity * DT, 1)
    base = straight_log(*[(0.0, 0.0, 0.0, 0.0)] * objects, steps=steps, signal=rng.integers(1, 4, steps))
    valid = base.valid.copy()
    valid[-2:, : steps // 2] = False
    valid[1, -steps // 4 :] = False
    types = np.array([AgentType.PEDESTRIAN if k % 5 == 4 else AgentType.VEHICLE for k in range(objects)], int)
    return dataclasses.replace(
        base, valid=valid, positions=positions, headings=heading, velocities=velocity, object_types=types
    )


def noisy_log(log: Log, seed: int, scale: float) -> Log:
    """The log with random walks of ``scale`` [m per step] added to all positions after the first."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0, scale, (log.num_objects, log.num_steps, 2)), 1)
    positions = log.positions.copy()
    positions[..., :2] += walk - walk[:, :1]
    return dataclasses.replace(log, positions=positions)


def select_objects(log: Log, rows: list[int]) -> Log:
    """The log with these objects, in this order."""
    fields = ("object_types", "valid", "positions", "headings", "velocities", "sizes")
    arrays = {name: getattr(log, name)[rows] for name in fields}
    ego = rows.index(log.ego_index) if log.ego_index in rows else NO_EGO
    return dataclasses.replace(log, object_ids=tuple(log.object_ids[k] for k in rows), ego_index=ego, **arrays)


def with_ghosts(log: Log, count: int) -> Log:
    """The log with objects that are never valid, whose values are NaN."""
    ghosts = select_objects(log, [0] * count)
    both = {
        name: np.concatenate([getattr(log, name), value])
        for name, value in {
            "object_types": ghosts.object_types,
            "valid": np.zeros_like(ghosts.valid),
            "positions": np.full_like(ghosts.positions, np.nan),
            "headings": np.full_like(ghosts.headings, np.nan),
            "velocities": np.full_like(ghosts.velocities, np.nan),
            "sizes": ghosts.sizes,
        }.items()
    }
    return dataclasses.replace(log, object_ids=(*log.object_ids, *(f"ghost {k}" for k in range(count))), **both)


def moved_log(log: Log, turn: float, shift: tuple[float, float]) -> Log:
    """The log turned around the origin [rad] and shifted [m]: objects, signals and lanes."""
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    offset = np.array([*shift, 0.0])
    lanes = tuple(dataclasses.replace(lane, points=lane.points @ matrix + offset) for lane in log.lanes)
    return dataclasses.replace(
        log,
        positions=log.positions @ matrix + offset,
        headings=(log.headings + turn + np.pi) % (2 * np.pi) - np.pi,
        velocities=log.velocities @ matrix[:2, :2],
        signal_positions=log.signal_positions @ matrix + offset,
        lanes=lanes,
    )
