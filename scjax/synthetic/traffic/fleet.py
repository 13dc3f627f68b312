"""Vehicles of a traffic simulation: their state in arrays, their poses, and random fleets."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.synthetic.lane_arrays import LaneArrays

AXLE_SHARE = 0.3  # of the length, from the center of a vehicle to each axle
_NONE = -1
_MAX_ENTRIES = 1000  # of a vehicle, by which its numbers differ
_WANDERING_SHARE = 0.3  # of vehicles that keep less to the centerline
_LATERAL_DEVIATIONS = (0.22, 0.6)  # m, of the others and of those
_MAX_LATERAL = 1.1  # m
_WANDERING_LENGTH = 6.0  # m, longer vehicles keep more to the centerline


@dataclasses.dataclass
class Fleet:
    """Vehicles of a simulation, arrays [vehicles].

    Attributes:
      lane: index of the lane; -1 for vehicles that wait to enter the map.
      along: position of the center along the lane [m].
      speed: [m/s].
      next_lane: lane that follows; -1 at the border of the map.
      previous_lane: lane before; -1 where none is known.
      granted: connector that the vehicle may enter; -1 for none.
      sizes: length, width, height [m].
      speed_factor: desired speed relative to that of the lane.
      lateral: offset to the left of the centerline [m].
      lateral_goal: offset that the vehicle moves to [m].
      lateral_speed: of this move [m/s].
      entries: how often the vehicle has entered the map.
    """

    lane: Int[np.ndarray, " n"]
    along: Float64[np.ndarray, " n"]
    speed: Float64[np.ndarray, " n"]
    next_lane: Int[np.ndarray, " n"]
    previous_lane: Int[np.ndarray, " n"]
    granted: Int[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]
    speed_factor: Float64[np.ndarray, " n"]
    lateral: Float64[np.ndarray, " n"]
    lateral_goal: Float64[np.ndarray, " n"]
    lateral_speed: Float64[np.ndarray, " n"]
    entries: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.lane)

    def select(self, rows: np.ndarray) -> Fleet:
        """The vehicles at indices or a mask ``rows``."""
        return Fleet(**{f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)})

    def extend(self, other: Fleet) -> Fleet:
        """These vehicles, then those of ``other``."""
        names = [f.name for f in dataclasses.fields(self)]
        return Fleet(**{name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names})

    def poses(
        self, lanes: LaneArrays, rows: Int[np.ndarray, " n"]
    ) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
        """Centers [m] and headings [rad] of the vehicles ``rows`` on the map: both axles keep to the lane."""
        reach = AXLE_SHARE * self.sizes[rows, 0]
        front = self._points(lanes, rows, self.along[rows] + reach)
        rear = self._points(lanes, rows, self.along[rows] - reach)
        axis = front - rear
        headings = np.arctan2(axis[:, 1], axis[:, 0])
        left = np.stack([-np.sin(headings), np.cos(headings)], -1)
        positions = (front + rear) / 2 + self.lateral[rows, None] * left
        drift = np.sign(self.lateral_goal[rows] - self.lateral[rows]) * self.lateral_speed[rows]
        drift = np.clip(drift, -0.35 * self.speed[rows], 0.35 * self.speed[rows])
        return positions, headings + np.arctan2(drift, np.maximum(self.speed[rows], 1.0))

    def _points(self, lanes: LaneArrays, rows: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Points at ``along`` of the vehicles' lanes, which goes on into the lanes before and after [n, 2]."""
        lane, length = self.lane[rows], lanes.length[self.lane[rows]]
        is_after = (along > length) & (self.next_lane[rows] >= 0)
        is_before = (along < 0) & (self.previous_lane[rows] >= 0)
        lane = np.where(is_after, self.next_lane[rows], np.where(is_before, self.previous_lane[rows], lane))
        before_length = lanes.length[np.where(is_before, self.previous_lane[rows], 0)]
        along = np.where(is_after, along - length, np.where(is_before, along + before_length, along))
        positions, headings = lanes.poses_at(lane, along)
        outside = along - np.clip(along, 0, lanes.length[lane])  # beyond the last lane: straight on
        return positions + outside[:, None] * np.stack([np.cos(headings), np.sin(headings)], -1)


def make_fleet(
    lanes: LaneArrays,
    lane: Int[np.ndarray, " n"],
    along: Float64[np.ndarray, " n"],
    speed: Float64[np.ndarray, " n"],
    sizes: Float64[np.ndarray, "n 3"],
    speed_factor: Float64[np.ndarray, " n"],
    lateral: Float64[np.ndarray, " n"],
    rng: np.random.Generator,
) -> Fleet:
    """Vehicles at places of lanes; what follows their lanes is drawn."""
    count = len(lane)
    return Fleet(
        lane=lane,
        along=along,
        speed=speed,
        next_lane=lanes.pick_successors(lane, rng.random(count), sizes[:, 0]),
        previous_lane=lanes.predecessor[lane],
        granted=np.full(count, _NONE),
        sizes=sizes,
        speed_factor=speed_factor,
        lateral=lateral,
        lateral_goal=lateral.copy(),
        lateral_speed=np.full(count, 0.8),
        entries=np.zeros(count, int),
    )


def draw_fleet(
    lanes: LaneArrays,
    density: Float64[np.ndarray, " lanes"],
    draw_sizes,
    rng: np.random.Generator,
) -> Fleet:
    """A random fleet on lanes that are no connectors.

    Args:
      density: vehicles per meter of each lane.
      draw_sizes: function (count) -> lengths, widths, heights [count, 3].
    """
    counts = rng.poisson(density * lanes.length * (lanes.junction < 0))
    lane = np.repeat(np.arange(len(counts)), counts)
    sizes = draw_sizes(len(lane))
    # Each lane has equal slots; slots that are too short for a vehicle and its gap stay empty.
    number = np.arange(len(lane)) - np.repeat(np.cumsum(counts) - counts, counts)
    slot = lanes.length[lane] / counts[lane]
    along = (number + rng.uniform(0.25, 0.75, len(lane))) * slot
    fits = slot > 2 * sizes[:, 0] + 3.0
    lane, along, sizes, slot = lane[fits], along[fits], sizes[fits], slot[fits]
    speed_factor = np.clip(rng.normal(1.05, 0.12, len(lane)), 0.7, 1.35)
    speed = np.minimum(lanes.speed[lane] * speed_factor, np.maximum((slot - sizes[:, 0]) / 2.5, 0.0))
    lateral = draw_laterals(len(lane), rng) * np.minimum(1.0, _WANDERING_LENGTH / sizes[:, 0])
    return make_fleet(lanes, lane, along, speed, sizes, speed_factor, lateral, rng)


def draw_laterals(count: int, rng: np.random.Generator) -> Float64[np.ndarray, " count"]:
    """Random offsets to the left of the centerline [m]: most vehicles keep to it."""
    spread = np.where(rng.random(count) < _WANDERING_SHARE, _LATERAL_DEVIATIONS[1], _LATERAL_DEVIATIONS[0])
    return np.clip(spread * rng.normal(size=count), -_MAX_LATERAL, _MAX_LATERAL)


def vehicle_ids(fleet: Fleet, rows: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Numbers of vehicles: others after each entry to the map."""
    return _MAX_ENTRIES * rows + np.mod(fleet.entries[rows], _MAX_ENTRIES)
