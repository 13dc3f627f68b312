"""The objects of a log as exports need them: every size and height filled, zeros where not observed, and an ego."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.export.base import Losses
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, Log
from scjax.scene.agent_sizes import CLASS_SIZES
from scjax.scene.limits import MAX_SIZE

LANE_WIDTH = 3.5
"""Width of every lane [m]: logs do not hold widths."""

_UNEVEN = 0.2  # of a step that a time may be off
_NEAR_LANE = 30.0  # m; objects farther from all lanes get no height from one


def filled_traffic(log: Log, losses: Losses) -> Log:
    """``log`` with finite values everywhere, without objects that are never observed.

    Sizes that are unknown or absurd become the mean of the class (``CLASS_SIZES``), a height that is unknown that of
    the nearest lane plus half the object's height, or 0. Where an object is not observed, all its states are zero.
    """
    observed = log.valid.any(1)
    losses["objects that are never observed, left out"] += int((~observed).sum())
    rows = np.flatnonzero(observed)
    ego = int(np.searchsorted(rows, log.ego_index)) if log.ego_index in rows else NO_EGO
    types, valid, sizes = log.object_types[rows], log.valid[rows], np.array(log.sizes[rows], np.float64)
    usual = np.array([CLASS_SIZES[AgentType.STATIC if kind == OTHER_OBJECT else AgentType(kind)] for kind in types])
    wrong = ~((np.nan_to_num(sizes) > 0) & (np.nan_to_num(sizes) <= MAX_SIZE))
    losses["objects of unknown size, written with the mean of their class"] += int(wrong.any(1).sum())
    sizes = np.where(wrong, usual.reshape(-1, 3), sizes)
    positions = np.where(valid[..., None], log.positions[rows], 0.0)
    unknown = np.isnan(positions[..., 2])
    losses["objects of unknown height, written on the nearest lane or at 0 m"] += int(unknown.any(1).sum())
    if unknown.any():
        half = np.broadcast_to(sizes[:, None, 2] / 2, unknown.shape)[unknown]
        positions[unknown, 2] = _lane_heights(log, positions[unknown, :2]) + half
    return dataclasses.replace(
        log,
        object_ids=tuple(log.object_ids[row] for row in rows),
        object_types=types,
        valid=valid,
        positions=positions,
        headings=np.where(valid, log.headings[rows], 0.0),
        velocities=np.where(valid[..., None], log.velocities[rows], 0.0),
        sizes=sizes,
        ego_index=ego,
    )


def _lane_heights(log: Log, places: np.ndarray) -> np.ndarray:
    """z of the nearest point of a lane at each x, y [m]; 0 where none is near."""
    from scipy.spatial import KDTree

    known = [lane.points for lane in log.lanes if not np.isnan(lane.points).any()]
    if not known:
        return np.zeros(len(places))
    points = np.concatenate(known)
    distance, row = KDTree(points[:, :2]).query(places)
    return np.where(distance <= _NEAR_LANE, points[row, 2], 0.0)


def log_with_ego(log: Log, losses: Losses, program: str) -> Log:
    """``log`` with an ego that is observed at every step.

    Without an ego the vehicle that is observed longest takes its place; of several, the one that drives farthest. Steps
    before and after the ego is observed are left out, gaps between are filled in a straight line.

    Args:
      program: that needs an ego, for messages.

    Raises:
      ValueError: no vehicle is observed.
    """
    ego = log.ego_index
    if ego == NO_EGO or not np.any(log.valid[ego]):
        vehicles = np.flatnonzero((log.object_types == AgentType.VEHICLE) & log.valid.any(1))
        if not len(vehicles):
            raise ValueError(f"the log has no vehicle: {program} needs a car to control, add one")
        ego = max(vehicles.tolist(), key=lambda row: (log.valid[row].sum(), _way(log, row)))
        losses["no ego: the vehicle that is observed longest takes its place"] += 1
    seen = np.flatnonzero(log.valid[ego])
    first, last = int(seen[0]), int(seen[-1])
    losses["steps at which the ego is not observed, left out"] += log.num_steps - (last + 1 - first)
    log = log[first : last + 1]
    gaps = np.flatnonzero(~log.valid[ego])
    if len(gaps):
        losses["steps at which the ego is not observed, filled in"] += len(gaps)
        log = _filled_gaps(log, ego, gaps)
    return dataclasses.replace(log, ego_index=ego)


def _way(log: Log, row: int) -> float:
    """Distance between the first and last place of an object [m]."""
    places = log.positions[row, log.valid[row], :2]
    return float(np.hypot(*(places[-1] - places[0])))


def _filled_gaps(log: Log, row: int, gaps: np.ndarray) -> Log:
    """``log`` in which an object has states at ``gaps`` too, linear in time."""
    seen, times = log.valid[row], log.timestamps
    positions, headings, velocities, valid = (
        np.array(values) for values in (log.positions, log.headings, log.velocities, log.valid)
    )
    for values in (positions, velocities):
        for column in range(values.shape[-1]):
            values[row, gaps, column] = np.interp(times[gaps], times[seen], values[row, seen, column])
    headings[row, gaps] = np.interp(times[gaps], times[seen], np.unwrap(headings[row, seen]))
    valid[row, gaps] = True
    return dataclasses.replace(log, positions=positions, headings=headings, velocities=velocities, valid=valid)


def even_steps(log: Log, losses: Losses) -> Log:
    """``log`` with steps of equal length, for formats that count steps; states stay as they are."""
    if log.num_steps < 2:
        return log
    times = log.timestamps[0] + log.dt * np.arange(log.num_steps)
    uneven = np.abs(times - log.timestamps) > _UNEVEN * log.dt
    losses["steps at uneven times, written at even ones"] += int(uneven.sum())
    return dataclasses.replace(log, timestamps=times)


def without_gaps(log: Log, losses: Losses) -> Log:
    """``log`` in which every object is observed from its first to its last step; states between are linear in time."""
    for row in range(log.num_objects):
        seen = np.flatnonzero(log.valid[row])
        gaps = np.setdiff1d(np.arange(seen[0], seen[-1] + 1), seen) if len(seen) else seen
        if len(gaps):
            losses["states in gaps between observations, filled in"] += len(gaps)
            log = _filled_gaps(log, row, gaps)
    return log
