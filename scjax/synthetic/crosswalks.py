"""Crosswalks, and the people on them: they wait for vehicles and signals, and vehicles wait for them."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import AgentType, Signal
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.network import Arm, Junction, Network
from scjax.synthetic.traffic.right_of_way import RightOfWay

_APPROACH = 6.0  # m that people walk before and after a crosswalk
_CURB = 2.6  # m from the centerline of the outermost lane to the curb where people wait
_BEFORE_STOP_LINE = 1.8  # m
_AWAY_TIME = (10.0, 60.0)  # s between two crossings of a person
_PASSED = 2.5  # m that a person is past the place where a connector crosses, before a vehicle may enter it
_PATIENCE = 4.0  # s at the curb, after which vehicles without signals let people cross
_IDS = 4 * 10**9


@dataclasses.dataclass(frozen=True)
class Crosswalks:
    """Crosswalks, each in one direction, arrays [crosswalks].

    Attributes:
      start, end: at the curbs [m].
      places: where connectors cross it, from its start [m], NaN for those that do not [crosswalks, lanes].
      arriving: those of them that come from its own arm; their signals hold for people [crosswalks, lanes].
    """

    start: Float64[np.ndarray, "n 2"]
    end: Float64[np.ndarray, "n 2"]
    places: Float64[np.ndarray, "n lanes"]
    arriving: Bool[np.ndarray, "n lanes"]

    @property
    def crossed(self) -> Bool[np.ndarray, "n lanes"]:
        """Connectors that cross the crosswalks."""
        return ~np.isnan(self.places)

    @property
    def length(self) -> Float64[np.ndarray, " n"]:
        """From curb to curb [m]."""
        return np.hypot(*(self.end - self.start).T)


def find_crosswalks(net: Network) -> Crosswalks:
    """Crosswalks in both directions, in front of the stop line of every arm with a sidewalk."""
    sidewalk_lanes = set(net.sidewalk_lanes)
    starts, ends, places, arriving = [], [], [], []
    for number, junction in enumerate(net.junctions):
        if junction.type in ("merge", "driveway"):
            continue
        connectors = [k for k, lane in enumerate(net.lanes) if lane.junction == number or k in junction.connectors]
        for a, arm in enumerate(junction.arms):
            if not sidewalk_lanes & {*(lane for lane, _ in arm.inbound), *arm.outbound}:
                continue
            start, end = _curbs(net, junction, arm)
            place, comes = np.full(len(net.lanes), np.nan), np.zeros(len(net.lanes), bool)
            for k in connectors:
                place[k] = _crossing_place(net.lanes[k].points, start, end)
                comes[k] = not np.isnan(place[k]) and net.lanes[k].arm == a and net.lanes[k].entry_lane >= 0
            for pair in ((start, end, place), (end, start, np.hypot(*(end - start)) - place)):
                starts.append(pair[0])
                ends.append(pair[1])
                places.append(pair[2])
                arriving.append(comes)
    lanes = len(net.lanes)
    return Crosswalks(
        np.array(starts, float).reshape(-1, 2),
        np.array(ends, float).reshape(-1, 2),
        np.array(places, float).reshape(-1, lanes),
        np.array(arriving, bool).reshape(-1, lanes),
    )


class CrosswalkWalkers:
    """People who cross again and again, each one crosswalk; between two times they are out of sight for a while."""

    def __init__(self, crosswalks: Crosswalks, mean: float, rng: np.random.Generator):
        """``mean``: people for each crosswalk."""
        counts = rng.poisson(mean, len(crosswalks.start))
        self.crosswalks = crosswalks
        self.crosswalk: Int[np.ndarray, " n"] = np.repeat(np.arange(len(counts)), counts)
        count = len(self.crosswalk)
        self.speed = np.clip(rng.normal(1.2, 0.28, count), 0.5, 2.2)
        away = self.speed * rng.uniform(*_AWAY_TIME, count)
        self.cycle = crosswalks.length[self.crosswalk] + 2 * _APPROACH + away
        self.along: Float64[np.ndarray, " n"] = rng.uniform(-_APPROACH - away, self.cycle - _APPROACH - away)
        self.left = rng.normal(0, 0.5, count)
        self.sizes = actors.draw_sizes(AgentType.PEDESTRIAN, count, rng)
        self.waited = np.zeros(count)  # s
        self.laps = np.zeros(count, int)
        # Nobody starts on the road.
        on_road = (self.along > 0) & (self.along < crosswalks.length[self.crosswalk])
        self.along[on_road] = -rng.uniform(0.5, _APPROACH, int(on_road.sum()))

    def step(self, seconds: float, way: RightOfWay) -> None:
        """Lets people walk for ``seconds``, and tells ``way`` which connectors they cross."""
        if not len(self.crosswalk):
            return
        length = self.crosswalks.length[self.crosswalk]
        step = self.speed * seconds
        at_curb = (self.along < 0) & (self.along + step >= 0)
        is_free = self._is_free(way)[self.crosswalk]
        self.waited = np.where(at_curb & ~is_free, self.waited + seconds, 0.0)
        self.along += np.where(at_curb & ~is_free, 0.0, step)
        is_over = self.along > length + _APPROACH
        self.along[is_over] -= self.cycle[is_over]
        self.laps[is_over] += 1
        on_road = (self.along >= 0) & (self.along <= length)
        has_signal = (way.signals[None] != Signal.UNKNOWN) & self.crosswalks.arriving
        goes_first = (self.waited > _PATIENCE) & ~has_signal.any(1)[self.crosswalk]
        way.occupied[:] = self.in_the_way(on_road | goes_first)

    def in_the_way(self, rows: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " lanes"]:
        """Connectors whose crossing some of the people have not passed yet, or only just."""
        is_before = np.less(self.along[rows, None], self.crosswalks.places[self.crosswalk[rows]] + _PASSED)
        return np.asarray(is_before.any(axis=0))

    def actors(self) -> Actors:
        """The people in sight now."""
        start, end = self.crosswalks.start[self.crosswalk], self.crosswalks.end[self.crosswalk]
        direction = (end - start) / self.crosswalks.length[self.crosswalk, None]
        left = np.stack([-direction[:, 1], direction[:, 0]], -1)
        positions = start + self.along[:, None] * direction + self.left[:, None] * left
        headings = np.arctan2(direction[:, 1], direction[:, 0])
        speeds = np.where(self.waited > 0, 0.0, self.speed)
        made = actors.make_actors(AgentType.PEDESTRIAN, positions, headings, speeds, self.sizes)
        made.ids = _IDS + 1000 * np.arange(len(made)) + self.laps
        return made.select(np.flatnonzero(self.along >= -_APPROACH))

    def _is_free(self, way: RightOfWay) -> np.ndarray:
        """Crosswalks without vehicles and without a green or yellow light across them."""
        shows = (way.signals == Signal.GO) | (way.signals == Signal.CAUTION)
        blocks = ((way.num_grants > 0) & self.crosswalks.crossed) | (shows & self.crosswalks.arriving)
        return np.logical_not(blocks.any(axis=1))


def _curbs(net: Network, junction: Junction, arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    """Both ends of the crosswalk of an arm [m]."""
    outwards = np.array([np.cos(arm.angle), np.sin(arm.angle)])
    left = np.array([-outwards[1], outwards[0]])
    ends = np.array(
        [net.lanes[lane].points[-1] for lane, _ in arm.inbound] + [net.lanes[lane].points[0] for lane in arm.outbound]
    )
    lateral = (ends - junction.center) @ left
    middle = junction.center + (((ends - junction.center) @ outwards).min() - _BEFORE_STOP_LINE) * outwards
    return middle + (lateral.min() - _CURB) * left, middle + (lateral.max() + _CURB) * left


def _crossing_place(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Where a polyline last crosses the segment from ``start`` to ``end``, seen along it [m]; NaN if it does not."""
    axis = end - start
    length = float(np.hypot(*axis))
    axis = axis / length
    offset = points - start
    along, across = offset @ axis, axis[0] * offset[:, 1] - axis[1] * offset[:, 0]
    changes = np.flatnonzero((across[:-1] < 0) != (across[1:] < 0))
    share = across[changes] / (across[changes] - across[changes + 1])
    places = along[changes] + share * (along[changes + 1] - along[changes])
    inside = places[(places > -0.5) & (places < length + 0.5)]
    return float(inside.max()) if len(inside) else np.nan
