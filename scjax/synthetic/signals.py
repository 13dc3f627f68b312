"""Traffic signals of a junction: phases, and the state of every connector over time."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from scjax.scene import Signal
from scjax.scene.angles import wrap_to_pi
from scjax.synthetic.lane_arrays import CONFLICT_DISTANCE
from scjax.synthetic.network import Junction, Network

YELLOW_TIME, CLEARANCE_TIME = 3.0, 2.0  # s
_YELLOW_SHARE = 0.95  # of the junctions that are drawn with a phase that is yellow at a moment
_NEXT_YELLOW_SHARE = 0.5  # of those, with the next phase yellow at the next moment
_MIN_OPPOSITE_ANGLE = np.deg2rad(140.0)


def plan_phases(net: Network, junction: Junction) -> list[frozenset[int]]:
    """Sets of connectors with green at the same time; no two of different arms cross.

    Two opposite arms share a phase if nothing crosses. If only their left turns cross something and have lanes of their
    own, these have a phase of their own. Otherwise each arm has a phase.
    """
    remaining = list(range(len(junction.arms)))
    phases: list[frozenset[int]] = []
    while remaining:
        a = remaining.pop(0)
        angles = {b: abs(wrap_to_pi(junction.arms[a].angle - junction.arms[b].angle)) for b in remaining}
        b = max(angles, key=lambda k: angles[k], default=None)
        if b is None or angles[b] <= _MIN_OPPOSITE_ANGLE:
            phases.append(_of_arms(net, junction, a))
            continue
        remaining.remove(b)
        both = _of_arms(net, junction, a, b)
        left = frozenset(k for k in both if net.lanes[k].turn == "left")
        if not _has_crossing(net, both):
            phases.append(both)
        elif all(_has_own_lane(net, junction, k) for k in left) and not any(
            _has_crossing(net, phase) for phase in (both - left, left)
        ):
            phases += [both - left, left]
        else:
            phases += [_of_arms(net, junction, a), _of_arms(net, junction, b)]
    return [phase for phase in phases if phase]


def _of_arms(net: Network, junction: Junction, *arms: int) -> frozenset[int]:
    return frozenset(k for k in junction.connectors if net.lanes[k].arm in arms)


def _has_crossing(net: Network, connectors: frozenset[int]) -> bool:
    """Whether connectors of different arms cross, join or come close to each other."""
    rows = sorted(connectors)
    return any(
        net.lanes[i].arm != net.lanes[j].arm
        and (
            bool(set(net.lanes[i].successors) & set(net.lanes[j].successors))
            or _cross(net.lanes[i].points, net.lanes[j].points)
            or _min_distance(net.lanes[i].points, net.lanes[j].points) < CONFLICT_DISTANCE
        )
        for i, j in itertools.combinations(rows, 2)
    )


def _min_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Smallest distance between points of two polylines [m]."""
    return float(np.sqrt(np.square(a[:, None] - b[None]).sum(-1).min()))


def _cross(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two polylines cross."""
    start_a, step_a = a[:-1, None], np.diff(a, axis=0)[:, None]
    start_b, step_b = b[None, :-1], np.diff(b, axis=0)[None]
    offset = start_b - start_a
    cross = step_a[..., 0] * step_b[..., 1] - step_a[..., 1] * step_b[..., 0]
    cross = np.where(np.abs(cross) < 1e-9, np.inf, cross)
    share_a = (offset[..., 0] * step_b[..., 1] - offset[..., 1] * step_b[..., 0]) / cross
    share_b = (offset[..., 0] * step_a[..., 1] - offset[..., 1] * step_a[..., 0]) / cross
    return bool(((share_a >= 0) & (share_a <= 1) & (share_b >= 0) & (share_b <= 1) & np.isfinite(cross)).any())


@dataclasses.dataclass(frozen=True)
class SignalTiming:
    """Timing of the signals of one junction.

    Attributes:
      phases: as in ``Junction``.
      green_times: of each phase [s].
      start: position in the cycle at time 0 [s].
    """

    phases: tuple[frozenset[int], ...]
    green_times: tuple[float, ...]
    start: float

    @classmethod
    def draw(cls, junction: Junction, moments: np.ndarray, rng: np.random.Generator) -> SignalTiming:
        """Random timing; phases with more connectors are longer. Often one is yellow at one of ``moments`` [s]."""
        greens = [rng.uniform(6, 10) + 2.0 * len(phase) ** 0.5 for phase in junction.phases]
        change = YELLOW_TIME + CLEARANCE_TIME
        is_yellow, first, moment = rng.random() < _YELLOW_SHARE, int(rng.integers(len(greens))), 0
        if is_yellow:
            moment = int(rng.integers(len(moments)))
            if moment + 1 < len(moments) and rng.random() < _NEXT_YELLOW_SHARE:
                greens[(first + 1) % len(greens)] = moments[moment + 1] - moments[moment] - change
        cycle = sum(greens) + len(greens) * change
        start = rng.uniform(0, cycle)
        if is_yellow:
            yellow = sum(greens[: first + 1]) + first * change + rng.uniform(0, YELLOW_TIME)
            start = (yellow - moments[moment]) % cycle
        return cls(tuple(junction.phases), tuple(float(green) for green in greens), float(start))

    def states(self, time: float) -> dict[int, Signal]:
        """The ``Signal`` of every connector at ``time`` [s]."""
        cycle = sum(self.green_times) + len(self.green_times) * (YELLOW_TIME + CLEARANCE_TIME)
        elapsed = (time + self.start) % cycle
        states = {k: Signal.STOP for phase in self.phases for k in phase}
        for phase, green in zip(self.phases, self.green_times, strict=True):
            if elapsed < green + YELLOW_TIME + CLEARANCE_TIME:
                if elapsed < green + YELLOW_TIME:
                    states |= dict.fromkeys(phase, Signal.GO if elapsed < green else Signal.CAUTION)
                return states
            elapsed -= green + YELLOW_TIME + CLEARANCE_TIME
        return states


def _has_own_lane(net: Network, junction: Junction, connector: int) -> bool:
    """Whether the lane before a connector allows left turns only."""
    entry = net.lanes[connector].entry_lane
    return {net.lanes[k].turn for k in junction.connectors if net.lanes[k].entry_lane == entry} == {"left"}
