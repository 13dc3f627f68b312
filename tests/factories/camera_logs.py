"""Logs for tests of cameras: boxes and lanes on level ground."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.camera import Camera, Rig, pinhole
from scjax.scene import AgentType, Log, MapLane, Signal

CAR = (4.0, 2.0, 1.5)  # m


def box_log(
    *boxes: tuple[float, float, float],
    sizes: Sequence[Sequence[float]] | None = None,
    types: Sequence[int] | None = None,
    lanes: Sequence[MapLane] = (),
    steps: int = 1,
    signals: Sequence[tuple[str, Signal]] = (),
) -> Log:
    """Objects that stand at (x, y, heading in degrees) on the ground at z = 0; object 0 is the ego."""
    count = len(boxes)
    size = np.array(sizes if sizes is not None else [CAR] * count, np.float64).reshape(count, 3)
    poses = np.array(boxes, np.float64).reshape(count, 3)
    positions = np.column_stack([poses[:, :2], size[:, 2] / 2])
    return Log(
        timestamps=0.1 * np.arange(steps),
        object_ids=tuple(map(str, range(count))),
        object_types=np.array(types if types is not None else [AgentType.VEHICLE] * count),
        valid=np.ones((count, steps), bool),
        positions=np.repeat(positions[:, None], steps, 1),
        headings=np.repeat(np.deg2rad(poses[:, 2:]), steps, 1),
        velocities=np.zeros((count, steps, 2)),
        sizes=size,
        ego_index=0 if count else -1,
        signal_lane_ids=tuple(name for name, _ in signals),
        signal_states=np.repeat(np.array([state for _, state in signals], int)[:, None], steps, 1),
        signal_positions=np.full((len(signals), 3), np.nan),
        lanes=tuple(lanes),
        has_topology=True,
    )


def flat_lane(name: str, *points: tuple[float, float]) -> MapLane:
    """A lane on the ground at z = 0."""
    return MapLane(name, "surface_street", np.array([(x, y, 0.0) for x, y in points]))


def level_rig(*, height: float = 1.0, size: tuple[int, int] = (200, 100), focal_length: float = 100.0) -> Rig:
    """One camera above the middle of its carrier, never scaled, that looks ahead; its principal point is (100, 50)."""
    return Rig(name="level", cameras=(level_camera(height=height, size=size, focal_length=focal_length),))


def level_camera(*, height: float = 1.0, size: tuple[int, int] = (200, 100), focal_length: float = 100.0) -> Camera:
    """The camera of ``level_rig``."""
    center = (size[0] / 2, size[1] / 2)
    return pinhole("front", *size, focal_length=focal_length, center=center, position=(0.0, 0.0, height))
