"""Signs that a log is not what it says: wrong units, wrong axes, boxes or maps that do not fit.

Each check returns one sentence with a number and the likely cause, or nothing. A check is one function and one line in
``CHECKS``. Bounds leave every recorded scene of Waymo, nuScenes, Argoverse 2 and CommonRoad alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float64

from scjax.data.lane_graph import SegmentIndex, nearest_lane
from scjax.metrics.plausibility import PLAUSIBLE_LENGTHS
from scjax.scene import AgentType, Log

_MOVING = 2.0  # m/s
_LEAST_VEHICLES = 3  # fewer say nothing about a file


@dataclasses.dataclass(frozen=True)
class _Motion:
    """Steps at which a vehicle moves, between two steps of a log that are both valid.

    Attributes:
      speed: by its positions [m/s], [objects, steps - 1].
      direction: of its motion [rad].
      moving: where both are meant: a vehicle, faster than 2 m/s.
    """

    speed: Float64[np.ndarray, "objects steps"]
    direction: Float64[np.ndarray, "objects steps"]
    moving: Bool[np.ndarray, "objects steps"]

    @classmethod
    def of(cls, log: Log) -> _Motion:
        offset = np.diff(log.positions[..., :2], axis=1)
        seconds = np.diff(log.timestamps)
        speed = np.hypot(offset[..., 0], offset[..., 1]) / seconds
        both = log.valid[:, 1:] & log.valid[:, :-1] & (log.object_types == AgentType.VEHICLE)[:, None]
        return cls(speed, np.arctan2(offset[..., 1], offset[..., 0]), both & (speed > _MOVING))

    def medians(self, values: np.ndarray) -> np.ndarray:
        """Median over the moving steps of every vehicle that moves at five steps or more."""
        return np.array([np.median(row[mask]) for row, mask in zip(values, self.moving, strict=True) if mask.sum() > 4])


def log_warnings(log: Log, index: SegmentIndex) -> list[str]:
    """What looks wrong in a log, one sentence each; see ``CHECKS``.

    Args:
      index: search structure of the log's lanes.
    """
    motion = _Motion.of(log)
    return [warning for check in CHECKS if (warning := check(log, motion, index))]


def _heading_range(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    wrong = log.valid & (np.abs(log.headings) > 2 * np.pi + 1e-3)
    if not wrong.any() or wrong.mean() < 0.01:
        return ""
    return f"{wrong.any(1).sum()} objects have headings beyond 2 pi: are they degrees? Files hold radians"


def _heading_of_motion(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    turn = np.abs(np.angle(np.exp(1j * (log.headings[:, 1:] - motion.direction))))
    medians = motion.medians(turn)
    wrong = medians > np.deg2rad(45.0)
    if len(medians) < _LEAST_VEHICLES or wrong.mean() < 0.5:
        return ""
    return (
        f"{wrong.sum()} of {len(medians)} moving vehicles do not head where they go: are headings clockwise, from "
        "north, or degrees? Files hold radians, counter-clockwise from +x"
    )


def _speed_of_motion(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    recorded = np.hypot(*np.moveaxis(log.velocities[:, 1:], -1, 0))
    ratios = motion.medians(recorded / np.maximum(motion.speed, 1e-6))
    if len(ratios) < _LEAST_VEHICLES or 0.6 < (middle := float(np.median(ratios))) < 1.7:
        return ""
    return (
        f"recorded speeds are {middle:.2g} times those by the positions: are velocities, positions or times in other "
        "units? Files hold m/s, m and s"
    )


def _speeds(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    medians = motion.medians(motion.speed)
    fast = medians > 60.0
    if len(medians) < _LEAST_VEHICLES or fast.mean() < 0.3:
        return ""
    return (
        f"{fast.sum()} of {len(medians)} moving vehicles are faster than 60 m/s by their positions: centimeters, feet?"
    )


def _box_sizes(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    for agent_type, (low, high) in PLAUSIBLE_LENGTHS.items():
        lengths = log.sizes[log.object_types == agent_type, 0]
        lengths = lengths[lengths > 0]  # others are filled, and counted by the build
        if len(lengths) >= _LEAST_VEHICLES and not low <= (middle := float(np.median(lengths))) <= high:
            word = agent_type.name.lower()
            return f"half of the {len(lengths)} {word}s are longer or shorter than {middle:.3g} m: other units than m?"
    return ""


def _map_extent(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    points = np.concatenate([lane.points[:, :2] for lane in log.lanes])
    extent = float((points.max(0) - points.min(0)).max())
    if extent >= 2.0 or np.abs(points).max() > 180.0:
        return ""
    return f"all lanes lie within {extent:.2g} m: are they degrees of latitude and longitude? Files hold meters"


def _lane_spacing(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    steps = [np.hypot(*np.diff(lane.points[:, :2], axis=0).T).max(initial=0.0) for lane in log.lanes]
    wide = int((np.array(steps) > 500.0).sum())
    return f"{wide} lanes have neighboring points more than 500 m apart: other units than m?" if wide else ""


def _vehicles_on_lanes(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    rows, steps = np.nonzero(motion.moving)
    vehicles = len(np.unique(rows))
    if vehicles < 2 * _LEAST_VEHICLES:
        return ""
    keep = np.linspace(0, len(rows) - 1, min(len(rows), 500)).astype(int)
    distance, heading, _ = nearest_lane(index, log.positions[rows[keep], steps[keep], :2])
    if (share := float((distance < 4.0).mean())) < 0.3:
        return f"{share:.0%} of moving vehicles are within 4 m of a lane: do map and objects have the same frame?"
    along = np.cos(heading - motion.direction[rows[keep], steps[keep]])[distance < 2.0]
    if len(along) > 50 and (against := float((along < -0.7).mean())) > 0.6:
        return f"{against:.0%} of moving vehicles drive against their lane: are lanes in driving direction?"
    return ""


def _overlaps(log: Log, motion: _Motion, index: SegmentIndex) -> str:
    from scipy.spatial import KDTree

    step = int(log.valid.sum(0).argmax())
    rows = np.flatnonzero(log.valid[:, step] & (log.object_types == AgentType.VEHICLE))
    if len(rows) < 2 * _LEAST_VEHICLES:
        return ""
    pairs = KDTree(log.positions[rows, step, :2]).query_pairs(0.7, output_type="ndarray")
    share = len(np.unique(pairs)) / len(rows)
    return f"{share:.0%} of vehicles stand in another one: are objects listed twice?" if share > 0.2 else ""


CHECKS: tuple[Callable[[Log, _Motion, SegmentIndex], str], ...] = (
    _heading_range,
    _heading_of_motion,
    _speed_of_motion,
    _speeds,
    _box_sizes,
    _map_extent,
    _lane_spacing,
    _vehicles_on_lanes,
    _overlaps,
)
