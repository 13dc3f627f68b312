"""Ten seconds of a town's traffic around one vehicle, with the map there, as a ``Log``."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import Log, LogMetadata
from scjax.towns.egos import STEPS_AHEAD, STEPS_BACK
from scjax.towns.simulation import STEP
from scjax.towns.town_traffic import TownTraffic

DOMAIN = "carla"
SIGHT = 130.0  # m around the ego's way
_POINTS_APART = 10  # steps between places of the ego that are compared


class TownMap:
    """The lanes of a town, found by place.

    Args:
      log: the town without traffic.
    """

    def __init__(self, log: Log):
        from scipy.spatial import KDTree

        self.log = log
        points, owners = [], []
        for row, lane in enumerate(log.lanes):
            steps = np.hypot(*np.diff(lane.points[:, :2], axis=0).T)
            parts = np.maximum(np.ceil(steps / 10.0).astype(int), 1)
            share = np.concatenate([np.arange(n) / n for n in parts] or [np.zeros(0)])
            segment = np.repeat(np.arange(len(parts)), parts)
            inner = lane.points[segment, :2] + share[:, None] * (lane.points[segment + 1] - lane.points[segment])[:, :2]
            points += [inner, lane.points[-1:, :2]]
            owners += [row] * (len(inner) + 1)
        self._tree, self._owners = KDTree(np.concatenate(points)), np.array(owners)

    def lanes_near(self, places: np.ndarray, radius: float) -> np.ndarray:
        """Rows of lanes with a point within ``radius`` [m] of one of ``places`` [n, 2], increasing."""
        hits = self._tree.query_ball_point(places, radius + 5.0)
        return np.unique(self._owners[np.unique(np.concatenate([np.array(hit, int) for hit in hits]))])


def cut_log(town: TownMap, traffic: TownTraffic, number: int, metadata: LogMetadata) -> Log:
    """The log around ego ``number`` of ``traffic.egos``: 2 s back and 8 s ahead of its moment, at 10 Hz.

    Times count from the moment. The ego is there at every step.
    """
    step, ego = map(int, traffic.egos[number])
    first, last = step - STEPS_BACK, step + STEPS_AHEAD + 1
    begin = traffic.offsets[ego] + first - traffic.starts[ego]
    way = traffic.positions[begin : begin + last - first, :2]
    objects = traffic.objects_between(first, last)
    valid = np.zeros((len(objects), last - first), bool)
    positions = np.zeros((len(objects), last - first, 3))
    headings = np.zeros((len(objects), last - first))
    velocities = np.zeros((len(objects), last - first, 2))
    for row, item in enumerate(map(int, objects)):
        low, high = max(int(traffic.starts[item]), first), min(int(traffic.ends[item]), last)
        track = slice(*(traffic.offsets[item] - traffic.starts[item] + np.array([low, high])))
        span = slice(low - first, high - first)
        inside = np.hypot(*(traffic.positions[track, :2] - way[span]).T) < SIGHT
        valid[row, span] = inside
        positions[row, span] = traffic.positions[track]
        headings[row, span] = traffic.headings[track]
        velocities[row, span] = _velocities(traffic, item, low, high)
    seen = valid.any(1)
    objects, valid = objects[seen], valid[seen]
    lanes = tuple(town.log.lanes[row] for row in town.lanes_near(way[::_POINTS_APART], SIGHT))
    names = {lane.id: lane for lane in lanes}
    rows = [row for row, name in enumerate(traffic.signal_lanes) if name in names]
    signals = [traffic.signal_lanes[row] for row in rows]
    return Log(
        timestamps=STEP * np.arange(-STEPS_BACK, STEPS_AHEAD + 1),
        object_ids=tuple(traffic.names[item] for item in objects),
        object_types=traffic.types[objects],
        valid=valid,
        positions=np.where(valid[..., None], positions[seen], 0.0),
        headings=np.where(valid, headings[seen], 0.0),
        velocities=np.where(valid[..., None], velocities[seen], 0.0),
        sizes=traffic.sizes[objects],
        ego_index=int(np.flatnonzero(objects == ego)[0]),
        signal_lane_ids=tuple(signals),
        signal_states=traffic.signal_states[rows, first:last].reshape(len(rows), last - first),
        signal_positions=np.array([names[name].points[0] for name in signals], np.float64).reshape(-1, 3),
        lanes=lanes,
        has_topology=True,
        metadata=dataclasses.replace(metadata, unknown_words={}, notes={}),
    )


def _velocities(traffic: TownTraffic, item: int, low: int, high: int) -> np.ndarray:
    """By the positions [steps, 2]; with one step more on each side where there is one."""
    start, end = int(traffic.starts[item]), int(traffic.ends[item])
    wide_low, wide_high = max(low - 1, start), min(high + 1, end)
    offset = int(traffic.offsets[item]) - start
    track = traffic.positions[offset + wide_low : offset + wide_high, :2]
    if len(track) < 2:
        return np.zeros((high - low, 2))
    return np.gradient(track, STEP, axis=0)[low - wide_low : high - wide_low]
