"""Phases of signals: which approach has green when; NumPy on the host."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Signal

GREEN, AMBER, ALL_RED = 10.0, 3.0, 1.0  # s
_JUNCTION_SIZE = 40.0  # m between signals of one junction, from one to the next
_SAME_AXIS = np.deg2rad(30.0)  # approaches of one axis, both directions, share their green
_MAX_AXES = 3  # phases of a junction; more would keep drivers waiting for minutes
_FIRST_CHANGES = (2.0, GREEN)  # s, between which the phase of time 0 ends


@dataclasses.dataclass(frozen=True)
class SignalPlan:
    """When S signals are green. Signals without a phase stay UNKNOWN.

    Attributes:
      cycle: of the junction of each signal [s]; 0 for a signal without phases.
      green: start of its green in the cycle [s].
      offset: time of the cycle at time 0 [s].
    """

    cycle: Float64[np.ndarray, " S"]
    green: Float64[np.ndarray, " S"]
    offset: Float64[np.ndarray, " S"]

    def states(self, times: Float64[np.ndarray, " T"]) -> Int[np.ndarray, "S T"]:
        """``Signal`` of each signal at ``times`` [s]."""
        cycle = np.where(self.cycle > 0, self.cycle, 1.0)[:, None]
        clock = (times[None] + self.offset[:, None] - self.green[:, None]) % cycle
        states = np.where(clock < GREEN, Signal.GO, np.where(clock < GREEN + AMBER, Signal.CAUTION, Signal.STOP))
        return np.where(self.cycle[:, None] > 0, states, Signal.UNKNOWN).astype(np.int32)


def plan_signals(
    positions: Float64[np.ndarray, "S 2"],
    headings: Float64[np.ndarray, " S"],
    states: Int[np.ndarray, " S"],
    rng: np.random.Generator,
) -> SignalPlan:
    """Phases of all signals, which show ``states`` at time 0 wherever these do not contradict each other.

    The signals of a junction take turns by axis: approaches that run the same way or against each other have green
    together, unless only one of them has it at time 0. The axis that shows GO or CAUTION at time 0 comes first. Where
    more than three axes meet, an approach joins the most similar of these.

    Args:
      positions, headings: stop points [m] and directions of travel there [rad].
      states: ``Signal`` at time 0. A junction whose signals are all UNKNOWN has none.
    """
    count = len(states)
    cycle, green, offset = np.zeros(count), np.zeros(count), np.zeros(count)
    for junction in _clusters(positions):
        if (states[junction] == Signal.UNKNOWN).all():
            continue
        axes = _axes(headings[junction], states[junction])
        turns = int(axes.max()) + 1
        length = (GREEN + AMBER + ALL_RED) * max(turns, 2)
        cycle[junction] = length
        green[junction] = axes * (GREEN + AMBER + ALL_RED)
        offset[junction] = _start(states[junction][axes == 0], rng) % length
    return SignalPlan(cycle, green, offset)


def _start(states: np.ndarray, rng: np.random.Generator) -> float:
    """Time of the cycle at time 0, in which the first axis shows ``states`` [s]."""
    if (states == Signal.GO).any():
        return GREEN - rng.uniform(*_FIRST_CHANGES)
    if (states == Signal.CAUTION).any():
        return GREEN + rng.uniform(0.0, AMBER - 1.0)
    return -rng.uniform(0.2, ALL_RED)


def _clusters(positions: np.ndarray) -> list[np.ndarray]:
    """Rows of the signals of every junction."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(positions) < 2:
        return [np.arange(len(positions))] if len(positions) else []
    labels = fcluster(linkage(positions, "single"), _JUNCTION_SIZE, "distance")
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


def _axes(headings: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Number of the axis of each signal of a junction; axis 0 shows GO or CAUTION if any does."""
    lit = np.isin(states, (Signal.GO, Signal.CAUTION))
    order = np.argsort(~lit, kind="stable")
    axes = np.full(len(headings), -1)
    firsts: list[int] = []
    for row in order.tolist():
        apart = [abs((headings[row] - headings[one] + np.pi / 2) % np.pi - np.pi / 2) for one in firsts]
        near = [k for k, one in enumerate(firsts) if apart[k] < _SAME_AXIS and lit[row] == lit[one]]
        if not near and len(firsts) == _MAX_AXES:
            near = [k for k, one in enumerate(firsts) if lit[row] == lit[one]] or list(range(_MAX_AXES))
        if near:
            axes[row] = min(near, key=lambda k: apart[k])
        else:
            axes[row] = len(firsts)
            firsts.append(row)
    return axes
