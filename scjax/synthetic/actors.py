"""Everybody on the map at one moment, and how large they are."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import AgentType

# Share, then mean and spread of length, width, height [m]; the shares are those of recorded traffic.
_VEHICLES = {
    "compact": (0.12, (4.25, 1.97, 1.50), (0.10, 0.05, 0.05)),
    "sedan": (0.46, (4.62, 2.06, 1.52), (0.11, 0.06, 0.06)),
    "suv": (0.24, (4.92, 2.12, 1.78), (0.16, 0.07, 0.08)),
    "pickup": (0.11, (5.38, 2.26, 1.95), (0.12, 0.09, 0.10)),
    "van": (0.045, (5.80, 2.32, 2.25), (0.25, 0.09, 0.20)),
    "truck": (0.018, (7.80, 2.60, 3.05), (1.30, 0.10, 0.30)),
    "bus": (0.007, (11.80, 2.85, 3.20), (0.60, 0.06, 0.10)),
}
_OTHERS = {
    AgentType.PEDESTRIAN: ((0.92, 0.85, 1.71), (0.10, 0.09, 0.14)),
    AgentType.CYCLIST: ((1.83, 0.85, 1.79), (0.11, 0.07, 0.12)),
}
CONE, BARRIER = (0.40, 0.40, 0.75), (1.80, 0.50, 1.00)  # metres
_SHARES = np.array([share for share, _, _ in _VEHICLES.values()])
_MEANS = np.array([mean for _, mean, _ in _VEHICLES.values()])
_SPREADS = np.array([spread for _, _, spread in _VEHICLES.values()])


@dataclasses.dataclass
class Actors:
    """Agents at one moment: ``AgentType``, middle of the box [m], heading [rad], speed [m/s], sizes [m].

    ``level`` is their height above the ground [m]; ``lane`` the lane that they drive on, -1 beside the roads.
    """

    types: Int[np.ndarray, " n"]
    places: Float64[np.ndarray, "n 2"]
    headings: Float64[np.ndarray, " n"]
    speeds: Float64[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]
    level: Float64[np.ndarray, " n"]
    lane: Int[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.types)

    def select(self, rows: np.ndarray) -> Actors:
        """Some of them."""
        return Actors(**{f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)})


def make(
    kind: AgentType, places, headings, speeds, sizes, level: np.ndarray | float = 0.0, lane: np.ndarray | int = -1
) -> Actors:
    """Agents of one kind; scalars stand for all."""
    count = len(places)
    spread = [np.broadcast_to(np.asarray(value, float), (count,)).copy() for value in (headings, speeds, level)]
    return Actors(
        np.full(count, int(kind)), np.asarray(places, float).reshape(count, 2), spread[0], spread[1],
        np.broadcast_to(np.asarray(sizes, float), (count, 3)).copy(), spread[2],
        np.broadcast_to(np.asarray(lane, int), (count,)).copy(),
    )  # fmt: skip


def together(groups: list[Actors]) -> Actors:
    """All groups in a row."""
    names = [f.name for f in dataclasses.fields(Actors)]
    return Actors(**{name: np.concatenate([getattr(group, name) for group in groups]) for name in names})


def vehicle_sizes(count: int, rng: np.random.Generator, long: bool = True) -> Float64[np.ndarray, "n 3"]:
    """Lengths, widths and heights of ``count`` vehicles; without ``long`` no trucks and buses."""
    shares = _SHARES * np.array([True] * 5 + [long] * 2)
    kind = rng.choice(len(shares), count, p=shares / shares.sum())
    return _MEANS[kind] + np.clip(rng.normal(size=(count, 3)), -2.2, 2.2) * _SPREADS[kind]


def sizes_of(kind: AgentType, count: int, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Sizes of pedestrians or cyclists."""
    mean, spread = _OTHERS[kind]
    return np.array(mean) + np.clip(rng.normal(size=(count, 3)), -2.2, 2.2) * np.array(spread)


def overlapping(actors: Actors, margin: float = 0.15) -> np.ndarray:
    """Pairs (i, j), i before j, whose boxes come closer than ``margin`` metres on one level (separating axes)."""
    if len(actors) < 2:
        return np.zeros((0, 2), int)
    reach = np.hypot(actors.sizes[:, 0], actors.sizes[:, 1]) / 2
    gap = actors.places[:, None] - actors.places[None]
    far = np.hypot(gap[..., 0], gap[..., 1])
    near = far < reach[:, None] + reach[None] + margin
    near &= np.abs(actors.level[:, None] - actors.level[None]) < 3.0
    i, j = np.nonzero(np.triu(near, 1))
    apart = np.zeros(len(i), bool)
    half = actors.sizes[:, :2] / 2 + margin / 2
    axes = np.stack([np.cos(actors.headings), np.sin(actors.headings)], -1)
    sides = np.stack([-axes[:, 1], axes[:, 0]], -1)
    offset = actors.places[j] - actors.places[i]
    for one in (i, j):
        for axis in (axes[one], sides[one]):
            radius = sum(
                half[who, 0] * np.abs((axes[who] * axis).sum(-1)) + half[who, 1] * np.abs((sides[who] * axis).sum(-1))
                for who in (i, j)
            )
            apart |= np.abs((offset * axis).sum(-1)) > radius
    return np.stack([i, j], -1)[~apart]
