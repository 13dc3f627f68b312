"""Traffic signals of a junction: phases, and the state of every connector over time."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.language.road import wrap_to_pi
from scjax.scene import Signal
from scjax.synthetic.network import Junction, Network

YELLOW_TIME, CLEARANCE_TIME = 3.0, 2.0  # s
_MIN_OPPOSITE_ANGLE = np.deg2rad(140.0)


def plan_phases(net: Network, junction: Junction) -> list[frozenset[int]]:
    """Sets of connectors with green at the same time: one per pair of opposite arms or single arm.

    Left turns of a pair have a phase of their own if they have lanes of their own; else they yield.
    """
    remaining = list(range(len(junction.arms)))
    phases = []
    while remaining:
        a = remaining.pop(0)
        angles = {b: abs(wrap_to_pi(junction.arms[a].angle - junction.arms[b].angle)) for b in remaining}
        b = max(angles, key=lambda k: angles[k], default=None)
        arms = [a]
        if b is not None and angles[b] > _MIN_OPPOSITE_ANGLE:
            remaining.remove(b)
            arms.append(b)
        connectors = [k for k in junction.connectors if net.lanes[k].arm in arms]
        protected = {k for k in connectors if net.lanes[k].turn == "left" and _has_own_lane(net, junction, k)}
        if len(arms) > 1 and protected:
            phases.append(frozenset(connectors) - protected)
            phases.append(frozenset(protected))
        else:
            phases.append(frozenset(connectors))
    return [phase for phase in phases if phase]


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
    def draw(cls, junction: Junction, rng: np.random.Generator) -> SignalTiming:
        """Random timing; phases with more connectors are longer."""
        greens = [rng.uniform(6, 10) + 2.0 * len(phase) ** 0.5 for phase in junction.phases]
        cycle = sum(greens) + len(greens) * (YELLOW_TIME + CLEARANCE_TIME)
        return cls(tuple(junction.phases), tuple(float(green) for green in greens), float(rng.uniform(0, cycle)))

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
