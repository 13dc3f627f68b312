"""Small road maps made by rule: straight and curved roads, intersections, a freeway merge. Right-hand traffic."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float64

from scjax.data.synthetic.curves import offset, spline
from scjax.data.synthetic.curves import turn as turn_curve

Turn = Literal["through", "left", "right"]
Movement = tuple[int, Turn]  # the arm that a vehicle comes from, and what it does
_TURNS: tuple[Turn | None, ...] = (None, "left", "through", "right")
WIDTH = 3.6  # metres between centrelines


@dataclasses.dataclass
class Lane:
    """A centreline in driving direction; ``turn`` is set on the connectors of an intersection."""

    points: Float64[np.ndarray, "points 2"]  # metres
    subtype: str = "surface_street"
    speed_limit: float = 30.0  # mph
    successors: list[int] = dataclasses.field(default_factory=list)
    left: tuple[int, int, int] | None = None  # lane, and the own first and last point beside it
    right: tuple[int, int, int] | None = None
    turn: Turn | None = None
    arm: int = -1  # the arm that a connector comes from


@dataclasses.dataclass
class RoadMap:
    """Lanes about the origin, reaching ``radius`` metres out, and the intersection's signal phases.

    A phase is a set of (arm, turn) that may drive at once without crossing paths; no phases, no intersection.
    """

    kind: str
    radius: float
    lanes: list[Lane] = dataclasses.field(default_factory=list)
    phases: list[set[Movement]] = dataclasses.field(default_factory=list)
    arms: list[tuple[float, float]] = dataclasses.field(default_factory=list)  # direction [rad], stop distance [m]


def make_map(kind: str, rng: np.random.Generator) -> RoadMap:
    """A random map of a kind in ``KINDS``."""
    return KINDS[kind](rng)


def _two_way(rng: np.random.Generator) -> RoadMap:
    made, counts = RoadMap("straight", 125.0), rng.integers(1, 4, 2).tolist()
    line = _line(2 * made.radius, rng.normal(0, 0.05), 2 * made.radius)
    median, limit = float(rng.choice([0.0, 0.0, 2.0, 5.0])), float(rng.choice([25, 30, 35, 45]))
    # Recorded maps are cut into pieces, and so is this road.
    _road(made, line, *counts, cuts=[int(rng.integers(20, len(line) - 20))], median=median, limit=limit)
    return made


def _curve(rng: np.random.Generator) -> RoadMap:
    made, counts = RoadMap("curve", 125.0), rng.integers(1, 3, 2).tolist()
    turn = rng.choice([-1, 1]) * rng.uniform(0.5, 1.6)
    line = _line(2 * made.radius, turn, abs(turn) * rng.uniform(45, 80))
    _road(made, line, *counts, cuts=[int(rng.integers(20, len(line) - 20))], limit=25.0)
    return made


def _intersection(rng: np.random.Generator, num_arms: int) -> RoadMap:
    """Arms 0 and 2 are one road, 1 (and 3) the other; every movement has its connectors."""
    made = RoadMap("four_way" if num_arms == 4 else "t_junction", 115.0)
    major, minor = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    counts = [major, minor, major, minor][:num_arms]
    angles = np.arange(num_arms) * np.pi / 2 + np.repeat(rng.normal(0, 0.12, 2), 2)[[0, 2, 1, 3][:num_arms]]
    angles = angles + rng.normal(0, 0.04, num_arms)
    median = float(rng.choice([0.0, 1.5, 3.0])) if major > 1 else 0.0
    roads = []
    for arm in range(num_arms):
        stop = WIDTH * max(counts[(arm + 1) % 2], 1) + median / 2 + rng.uniform(5, 8)
        made.arms.append((float(angles[arm]), stop))
        line = np.arange(stop, made.radius + 1e-6, 2.0)[:, None] * np.array([np.cos(angles[arm]), np.sin(angles[arm])])
        gap = median if arm % 2 == 0 else 0.0
        roads += _road(made, line, counts[arm], counts[arm], median=gap, limit=30.0)
    for arm in range(num_arms):
        entries = roads[arm][1]
        for other in range(num_arms):
            turn = _TURNS[(arm - other) % 4]
            exits = roads[other][0]
            if turn == "through":
                pairs = list(zip(entries, exits, strict=False))
            elif turn is not None:
                pairs = [(entries[0], exits[0])] if turn == "left" else [(entries[-1], exits[-1])]
            else:
                continue
            for entry, leave in pairs:
                connector = Lane(turn_curve(made.lanes[entry].points, made.lanes[leave].points), turn=turn, arm=arm)
                made.lanes[entry].successors.append(len(made.lanes))
                connector.successors.append(leave)
                made.lanes.append(connector)
    for arm in range(num_arms):  # one arm after the other
        made.phases.append({(arm, "through"), (arm, "left"), (arm, "right")})
    for a, b in ((0, 2), (1, 3))[: num_arms // 2]:  # opposite arms together
        both: set[Movement] = {(a, "through"), (a, "right"), (b, "through"), (b, "right")}
        made.phases += [both, both]  # twice as long as the others
        made.phases.append({(a, "left"), (b, "left")})
    return made


def _merge(rng: np.random.Generator) -> RoadMap:
    """A freeway with an acceleration lane: the ramp runs beside it and ends by joining its right lane."""
    made, count = RoadMap("merge", 190.0), int(rng.integers(2, 4))
    line = _line(2 * made.radius, rng.normal(0, 0.1), 2 * made.radius)
    cuts = [int(rng.integers(75, 90)), int(rng.integers(115, 135))]
    _, (along, _), (onward, _) = _road(made, line, count, 0, cuts=cuts, subtype="freeway", limit=65.0)
    beside, joined = made.lanes[along[-1]], made.lanes[onward[-1]]
    shift = np.interp(np.linspace(0, 1, len(beside.points)), [0.6, 1.0], [1.0, 0.0])
    shift = WIDTH * shift**2 * (3 - 2 * shift)  # smooth taper into the right lane
    ramp_end, wide = len(made.lanes), int(0.7 * len(beside.points))
    joining = Lane(offset(beside.points, -shift), "freeway", 65.0, [onward[-1]], left=(along[-1], 0, wide))
    joining.points[-1] = joined.points[0]
    beside.right = (ramp_end, 0, wide)
    made.lanes.append(joining)
    ahead = joining.points[1] - joining.points[0]
    ahead /= np.linalg.norm(ahead)
    aside = np.array([ahead[1], -ahead[0]])
    far = joining.points[0] - rng.uniform(90, 130) * ahead + rng.uniform(20, 35) * aside
    toward = joining.points[0] - far
    toward = toward / np.linalg.norm(toward) + 0.4 * aside
    approach = spline(far, float(np.arctan2(*toward[::-1])), joining.points[0], float(np.arctan2(*ahead[::-1])))
    made.lanes.append(Lane(approach, "freeway", 45.0, [ramp_end]))
    if rng.random() < 0.6:
        _road(made, offset(line, WIDTH * 1.5 + rng.uniform(2, 8))[::-1], count, 0, subtype="freeway", limit=65.0)
    return made


KINDS = {
    "straight": _two_way,
    "curve": _curve,
    "four_way": lambda rng: _intersection(rng, 4),
    "t_junction": lambda rng: _intersection(rng, 3),
    "merge": _merge,
}


def _road(
    made: RoadMap, line: np.ndarray, forward: int, backward: int, *, cuts: Sequence[int] = (), median: float = 0.0,
    subtype: str = "surface_street", limit: float = 35.0,
) -> list[tuple[list[int], list[int]]]:  # fmt: skip
    """Adds lanes on both sides of ``line``, cut at these point indices, and joins them.

    Returns, for every piece, the lanes along it and those against it, innermost first.
    """
    pieces: list[tuple[list[int], list[int]]] = []
    bounds = [0, *cuts, len(line) - 1]
    for start, end in itertools.pairwise(bounds):
        whole, sides = (0, end - start), ([], [])
        for backwards, count in ((False, forward), (True, backward)):
            for k in range(count):
                # Offset before cutting: the pieces meet exactly, in bends too.
                points = offset(line, (1 if backwards else -1) * (median / 2 + WIDTH * (k + 0.5)))[start : end + 1]
                me = len(made.lanes)
                sides[backwards].append(me)
                made.lanes.append(
                    Lane(
                        points[::-1] if backwards else points, subtype, limit,
                        left=(me - 1, *whole) if k else None, right=(me + 1, *whole) if k + 1 < count else None,
                    )
                )  # fmt: skip
        pieces.append(sides)
    for near, far in itertools.pairwise(pieces):
        for before, after in zip(near[0] + far[1], far[0] + near[1], strict=True):
            made.lanes[before].successors.append(after)
    return pieces


def _line(length: float, turn: float, bend: float) -> np.ndarray:
    """Points 2 m apart through the origin: a bend of ``turn`` radians over ``bend`` metres between two straights."""
    arc = np.arange(-length / 2, length / 2 + 1e-6, 2.0)
    heading = np.clip(arc / bend, -0.5, 0.5) * turn
    steps = 2.0 * np.stack([np.cos(heading), np.sin(heading)], -1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum((steps[1:] + steps[:-1]) / 2, 0)])
    return points - points[len(points) // 2]
