"""Signal phases of a junction, and what its lights show at a time."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.language.road import wrap_to_pi
from scjax.scene import Signal
from scjax.synthetic.network import Junction, Network

YELLOW, CLEARING = 3.0, 2.0  # seconds
_OPPOSITE = np.deg2rad(140.0)


def plan_phases(net: Network, junction: Junction) -> list[frozenset[int]]:
    """Sets of connectors that have green together: opposite arms, their left turns apart where these have lanes.

    Left turns without a lane of their own share the green and give way.
    """
    left_over = list(range(len(junction.arms)))
    phases = []
    while left_over:
        a = left_over.pop(0)
        apart = {b: abs(wrap_to_pi(junction.arms[a].angle - junction.arms[b].angle)) for b in left_over}
        b = max(apart, key=lambda k: apart[k], default=None)
        pair = [a]
        if b is not None and apart[b] > _OPPOSITE:
            left_over.remove(b)
            pair.append(b)
        own = [k for k in junction.connectors if net.lanes[k].arm in pair]
        protected = {k for k in own if net.lanes[k].turn == "left" and _own_lane(net, junction, k)}
        if len(pair) > 1 and protected:
            phases.append(frozenset(own) - protected)
            phases.append(frozenset(protected))
        else:
            phases.append(frozenset(own))
    return [phase for phase in phases if phase]


@dataclasses.dataclass(frozen=True)
class Timing:
    """Lights of one junction over time: seconds of green of each phase, and the start of the cycle."""

    phases: tuple[frozenset[int], ...]
    greens: tuple[float, ...]
    start: float

    @classmethod
    def drawn(cls, junction: Junction, rng: np.random.Generator) -> Timing:
        """Greens by the number of lanes that they serve."""
        greens = [rng.uniform(6, 10) + 2.0 * len(phase) ** 0.5 for phase in junction.phases]
        cycle = sum(greens) + len(greens) * (YELLOW + CLEARING)
        return cls(tuple(junction.phases), tuple(float(green) for green in greens), float(rng.uniform(0, cycle)))

    def states(self, time: float) -> dict[int, Signal]:
        """The ``Signal`` of every connector at ``time`` [s]."""
        cycle = sum(self.greens) + len(self.greens) * (YELLOW + CLEARING)
        left = (time + self.start) % cycle
        shown = {k: Signal.STOP for phase in self.phases for k in phase}
        for phase, green in zip(self.phases, self.greens, strict=True):
            if left < green + YELLOW + CLEARING:
                if left < green + YELLOW:
                    shown |= dict.fromkeys(phase, Signal.GO if left < green else Signal.CAUTION)
                return shown
            left -= green + YELLOW + CLEARING
        return shown


def _own_lane(net: Network, junction: Junction, connector: int) -> bool:
    """Whether the lane that a connector starts from allows this turn alone."""
    entry = net.lanes[connector].entry
    return {net.lanes[k].turn for k in junction.connectors if net.lanes[k].entry == entry} == {"left"}
