"""Agents of a world at one moment, and random sizes of vehicles, pedestrians and cyclists."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import AgentType

Size = tuple[float, float, float]
"""Length, width, height [m]."""


class _SizeDistribution(NamedTuple):
    """Normal distribution of sizes, clipped at 2.2 standard deviations; ``share`` is that of the body type."""

    share: float
    mean: Size
    deviation: Size


# Shares of recorded traffic.
_VEHICLES = {
    "motorcycle": _SizeDistribution(0.012, (2.20, 0.85, 1.55), (0.10, 0.05, 0.08)),
    "compact": _SizeDistribution(0.12, (4.25, 1.97, 1.50), (0.10, 0.05, 0.05)),
    "sedan": _SizeDistribution(0.46, (4.62, 2.06, 1.52), (0.11, 0.06, 0.06)),
    "suv": _SizeDistribution(0.24, (4.92, 2.12, 1.78), (0.16, 0.07, 0.08)),
    "pickup": _SizeDistribution(0.11, (5.38, 2.26, 1.95), (0.12, 0.09, 0.10)),
    "van": _SizeDistribution(0.045, (5.80, 2.32, 2.25), (0.25, 0.09, 0.20)),
    "truck": _SizeDistribution(0.018, (7.80, 2.60, 3.05), (1.30, 0.10, 0.30)),
    "bus": _SizeDistribution(0.007, (11.80, 2.85, 3.20), (0.60, 0.06, 0.10)),
    "truck with trailer": _SizeDistribution(0.004, (16.0, 2.60, 3.80), (0.80, 0.05, 0.15)),
}
_LONG_VEHICLES = ("truck", "bus", "truck with trailer")
_OTHERS = {
    AgentType.PEDESTRIAN: _SizeDistribution(1.0, (0.92, 0.85, 1.71), (0.10, 0.09, 0.14)),
    AgentType.CYCLIST: _SizeDistribution(1.0, (1.83, 0.85, 1.79), (0.11, 0.07, 0.12)),
}
CONE_SIZE: Size = (0.40, 0.40, 0.75)
BARRIER_SIZE: Size = (1.80, 0.50, 1.00)
_MAX_DEVIATIONS = 2.2
_LEVEL_HEIGHT = 3.0  # m, agents further apart in height do not overlap


@dataclasses.dataclass
class Actors:
    """Agents at one moment, arrays [agents].

    Attributes:
      types: ``AgentType``.
      positions: centers of the boxes [m].
      headings, speeds: [rad, m/s].
      sizes: length, width, height [m].
      level: height above the ground [m].
      lane: index of the lane that the agent drives on, -1 off the road.
      ids: the same number at every moment; -1 where none is given.
    """

    types: Int[np.ndarray, " n"]
    positions: Float64[np.ndarray, "n 2"]
    headings: Float64[np.ndarray, " n"]
    speeds: Float64[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]
    level: Float64[np.ndarray, " n"]
    lane: Int[np.ndarray, " n"]
    ids: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.types)

    def select(self, rows: np.ndarray) -> Actors:
        """The agents at indices or a mask ``rows``."""
        return Actors(**{f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)})


def make_actors(
    agent_type: AgentType,
    positions,
    headings,
    speeds,
    sizes,
    level: np.ndarray | float = 0.0,
    lane: np.ndarray | int = -1,
) -> Actors:
    """Agents of one type; scalars and single sizes apply to all of them."""
    count = len(positions)
    headings, speeds, level = (
        np.broadcast_to(np.asarray(value, float), (count,)).copy() for value in (headings, speeds, level)
    )
    return Actors(
        types=np.full(count, int(agent_type)),
        positions=np.asarray(positions, float).reshape(count, 2),
        headings=headings,
        speeds=speeds,
        sizes=np.broadcast_to(np.asarray(sizes, float), (count, 3)).copy(),
        level=level,
        lane=np.broadcast_to(np.asarray(lane, int), (count,)).copy(),
        ids=np.full(count, -1),
    )


def no_actors() -> Actors:
    """Zero agents."""
    return make_actors(AgentType.VEHICLE, np.zeros((0, 2)), 0.0, 0.0, np.zeros((0, 3)))


def concatenate_actors(groups: list[Actors]) -> Actors:
    """All groups in one, in order."""
    names = [f.name for f in dataclasses.fields(Actors)]
    return Actors(**{name: np.concatenate([getattr(group, name) for group in groups]) for name in names})


def draw_vehicle_sizes(
    count: int, rng: np.random.Generator, long: bool = True, long_factor: float = 1.0
) -> Float64[np.ndarray, "n 3"]:
    """Random sizes of ``count`` vehicles [m]; trucks ``long_factor`` times as often, without ``long`` none."""
    shares = np.array([body.share for body in _VEHICLES.values()])
    shares = shares * np.array([long * long_factor if name in _LONG_VEHICLES else 1.0 for name in _VEHICLES])
    body = rng.choice(len(shares), count, p=shares / shares.sum())
    mean = np.array([body.mean for body in _VEHICLES.values()])[body]
    deviation = np.array([body.deviation for body in _VEHICLES.values()])[body]
    return mean + np.clip(rng.normal(size=(count, 3)), -_MAX_DEVIATIONS, _MAX_DEVIATIONS) * deviation


def draw_sizes(agent_type: AgentType, count: int, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Random sizes of ``count`` pedestrians or cyclists [m]."""
    sizes = _OTHERS[agent_type]
    normal = np.clip(rng.normal(size=(count, 3)), -_MAX_DEVIATIONS, _MAX_DEVIATIONS)
    return np.array(sizes.mean) + normal * np.array(sizes.deviation)


def overlapping_actors(actors: Actors, margin: float = 0.15) -> Int[np.ndarray, "pairs 2"]:
    """Pairs (i, j), i < j, of boxes with a gap below ``margin`` [m] on the same level (separating axis test)."""
    if len(actors) < 2:
        return np.zeros((0, 2), int)
    radius = np.hypot(actors.sizes[:, 0], actors.sizes[:, 1]) / 2
    offset = actors.positions[:, None] - actors.positions[None]
    is_near = np.hypot(offset[..., 0], offset[..., 1]) < radius[:, None] + radius[None] + margin
    is_near &= np.abs(actors.level[:, None] - actors.level[None]) < _LEVEL_HEIGHT
    i, j = np.nonzero(np.triu(is_near, 1))
    separated = np.zeros(len(i), bool)
    half = actors.sizes[:, :2] / 2 + margin / 2
    axes = np.stack([np.cos(actors.headings), np.sin(actors.headings)], -1)
    sides = np.stack([-axes[:, 1], axes[:, 0]], -1)
    offset = actors.positions[j] - actors.positions[i]
    for rows in (i, j):
        for axis in (axes[rows], sides[rows]):
            extent = sum(
                half[k, 0] * np.abs((axes[k] * axis).sum(-1)) + half[k, 1] * np.abs((sides[k] * axis).sum(-1))
                for k in (i, j)
            )
            separated |= np.abs((offset * axis).sum(-1)) > extent
    return np.stack([i, j], -1)[~separated]
