"""Random plans of streets: roads, crossings, side streets, blocks, roundabouts, dead ends; each about the origin."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.synthetic.curves import Line, by_curvature, moved, straight
from scjax.synthetic.network import MPS_OF_MPH
from scjax.synthetic.plan import Edge, Node, Plan
from scjax.synthetic.roads import Profile, Side

REACH = 150.0  # metres from the middle to the edge of the map
_APART = 16.0  # metres between the middles of roads that do not meet
_POCKET = 3.0  # metres of median that a left-turn pocket needs


@dataclasses.dataclass(frozen=True)
class Style:
    """What streets of a domain are like: ranges of limits [mph], widths [m], and shares of features."""

    limits: tuple[int, ...]
    widths: tuple[float, float]
    lanes: tuple[float, ...]  # share of 1, 2, ... lanes a direction on main roads
    medians: tuple[float, ...]  # metres, drawn with equal chances
    centre_turn: float = 0.0
    one_way: float = 0.0
    parking: float = 0.0
    walks: float = 1.0
    signals: float = 0.6
    pockets: float = 0.5
    bends: float = 0.3
    branches: tuple[float, float, float] = (0.25, 0.4, 0.35)  # share of arms with 0, 1, 2 streets that end on them


def road(style: Style, rng: np.random.Generator) -> Plan:
    """One road without junctions: straight, curved or winding; lanes may be added or end on it."""
    profile, out, back = _main(style, rng)
    if rng.random() < 0.3:
        out = dataclasses.replace(out, **{str(rng.choice(["right_pocket", "ending"])): rng.uniform(110, 190)})
    line = _free_line(rng, bend=float(rng.random() < style.bends + 0.25), speed=profile.speed)
    return Plan(edges=[Edge(line, profile, out, back)])


def crossing(style: Style, rng: np.random.Generator) -> Plan:
    """A four-way, T- or Y-junction, often with another junction further along."""
    plan = Plan([Node(np.zeros(2), bool(rng.random() < style.signals), corner=rng.uniform(3, 6))])
    shape = rng.choice(["four", "T", "Y"], p=[0.52, 0.42, 0.06])
    if shape == "Y":
        angles = np.array([0.0, 2.1, -2.1]) + rng.normal(0, 0.12, 3)
    else:
        skew = rng.normal(0, 0.08) if rng.random() < 0.8 else rng.choice([-1, 1]) * rng.uniform(0.3, 0.6)
        cross = np.pi / 2 + skew
        angles = np.array([0.0, np.pi, cross, cross - np.pi][: 4 if shape == "four" else 3]) + rng.normal(0, 0.03)
        if shape == "T" and rng.random() < 0.5:
            angles = -angles
    main = _main(style, rng)
    cross_street = _main(style, rng) if rng.random() < 0.45 else _minor(style, rng)
    _arms(plan, 0, angles, [main, main, cross_street, cross_street], style, rng)
    return plan


def side_streets(style: Style, rng: np.random.Generator) -> Plan:
    """A road with streets and driveways that end on it."""
    profile, out, back = _main(style, rng)
    line = _free_line(rng, bend=0.3 * float(rng.random() < style.bends), speed=profile.speed)
    places = np.cumsum(rng.uniform(26, 55, int(rng.integers(3, 7)))) + rng.uniform(50, 100)
    plan = Plan()
    _along(plan, Edge(line, profile, out, back), places[places < 2 * REACH - 60], [], rng)
    return plan


def blocks(style: Style, rng: np.random.Generator) -> Plan:
    """Two by two junctions of a town's grid; some streets are one-way."""
    spacing = rng.uniform(62, 105, 2)
    places = [np.array([x, y]) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    lit = bool(rng.random() < style.signals)
    plan = Plan([Node(spacing * place, lit, corner=rng.uniform(3, 5)) for place in places])
    streets = [_main(style, rng) if rng.random() < 0.4 else _minor(style, rng) for _ in range(4)]
    for k, (profile, out, back) in enumerate(streets):
        # Streets 0 and 1 run along y at the two x, 2 and 3 along x at the two y.
        first, second = ((0, 1), (2, 3), (0, 2), (1, 3))[k]
        direction = np.pi / 2 if k < 2 else 0.0
        a, b = plan.nodes[first].centre, plan.nodes[second].centre
        plain = dataclasses.replace(profile, centre_turn=False)
        rank = 3 * (k % 2)
        between = straight(a, direction, float(np.hypot(*(b - a))))
        plan.edges.append(Edge(between, plain, out, back, first, second, rank))
        far = REACH - float(np.abs(a).max())
        plan.edges.append(Edge(straight(b, direction, far), plain, out, back, second, None, rank))
        plan.edges.append(Edge(straight(a, direction + np.pi, far), plain, back, out, first, None, rank))
    return plan


def roundabout(style: Style, rng: np.random.Generator) -> Plan:
    """Three or four arms on a ring."""
    count = int(rng.choice([3, 4], p=[0.35, 0.65]))
    plan = Plan([Node(np.zeros(2), ring=float(rng.uniform(13, 20)))])
    angles = np.arange(count) * 2 * np.pi / count + rng.normal(0, 0.08, count)
    limit = float(rng.choice(style.limits)) * MPS_OF_MPH
    median, walks = float(rng.choice([0.0, 1.5])), _chance(style.walks, rng)
    profile = Profile(limit, rng.uniform(*style.widths), median=median, walks=walks)
    _arms(plan, 0, angles, [(profile, Side(1), Side(1))] * count, style, rng)
    return plan


def dead_end(style: Style, rng: np.random.Generator) -> Plan:
    """A residential street off another one that ends within view."""
    plan = Plan([Node(np.zeros(2), corner=4.0)])
    profile, out, back = _minor(style, rng)
    profile = dataclasses.replace(profile, parking=True)
    angles = np.array([0.0, np.pi, np.pi / 2 + rng.normal(0, 0.1)])
    _arms(plan, 0, angles[:2], [(profile, out, back)] * 2, style, rng)
    line = moved(by_curvature([25, rng.uniform(20, 60)], [0, 0, rng.normal(0, 0.006)]), np.zeros(2), float(angles[2]))
    quiet = dataclasses.replace(profile, speed=20 * MPS_OF_MPH)
    plan.edges.append(Edge(line, quiet, Side(1), Side(1), 0, None, 3))
    return plan


def _arms(
    plan: Plan, node: int, angles: np.ndarray, roads: list[tuple[Profile, Side, Side]], style: Style,
    rng: np.random.Generator,
) -> None:  # fmt: skip
    """Edges outwards from a node, the first two those of the main road; side streets and driveways end on them."""
    lines = []
    for angle in angles:
        bend = rng.normal(0, 0.006) if rng.random() < style.bends else 0.0
        bent = by_curvature([45, 30, REACH - 75], [0, 0, bend, bend])
        lines.append(moved(bent, plan.nodes[node].centre, float(angle)))
    for k, (profile, out, back) in enumerate(roads[: len(lines)]):
        if k % 2:  # the second arm of a road sees its directions the other way round
            out, back = back, out
        back = _with_pockets(back, profile, style, rng)
        count = int(rng.choice([0, 1, 2], p=style.branches))
        places = np.cumsum(rng.uniform(26, 55, count)) + rng.uniform(8, 24)
        others = [line for j, line in enumerate(lines) if j != k]
        road = Edge(lines[k], profile, out, back, node, None, 0 if k < 2 else 3)
        lines += _along(plan, road, places[places < REACH - 35], others, rng)


def _along(plan: Plan, road: Edge, places: np.ndarray, others: list[Line], rng: np.random.Generator) -> list[Line]:
    """Adds ``road`` with streets and driveways that end on it at ``places`` [m], clear of ``others``; their lines.

    Turn pockets of its way back are kept where it begins alone.
    """
    line, added = road.line, []
    spacing = float(np.hypot(*(line[1] - line[0])))
    first, begin, back = road.a, 0, road.back
    for place in places:
        at = round(place / spacing)
        driveway = bool(rng.random() < 0.6)
        ahead = line[at + 1] - line[at - 1]
        side = float(rng.choice([-1, 1]))
        branches = []
        for sign in (side, -side) if rng.random() < 0.2 else (side,):
            angle = float(np.arctan2(ahead[1], ahead[0])) + sign * (np.pi / 2 + rng.normal(0, 0.07))
            branch = _branch(line[at], angle, driveway, len(plan.nodes), rng)
            if _clear(branch.line, others + added):
                branches.append(branch)
        if not branches:
            continue
        plan.nodes.append(Node(line[at], corner=2.5 if driveway else 4.0, driveway=driveway))
        plan.edges += branches
        added += [branch.line for branch in branches]
        number = len(plan.nodes) - 1
        plan.edges.append(dataclasses.replace(road, line=line[begin : at + 1], back=back, a=first, b=number))
        first, begin = number, at
        back = dataclasses.replace(road.back, left_pocket=0.0, right_pocket=0.0)
    plan.edges.append(dataclasses.replace(road, line=line[begin:], back=back, a=first))
    return added


def _clear(line: Line, others: list[Line]) -> bool:
    """Whether a line keeps away from all others."""
    return all(np.square(line[:, None] - other[None]).sum(-1).min() > _APART**2 for other in others)


def _branch(start: np.ndarray, angle: float, driveway: bool, node: int, rng: np.random.Generator) -> Edge:
    length = rng.uniform(22, 32) if driveway else rng.uniform(70, 110)
    profile = Profile(
        (10 if driveway else 25) * MPS_OF_MPH, 3.0 if driveway else 3.3, parking=not driveway and rng.random() < 0.5,
        walks=not driveway,
    )  # fmt: skip
    line = moved(by_curvature([20, length - 20], [0, 0, rng.normal(0, 0.004)]), start, angle)
    return Edge(line, profile, Side(1), Side(1), node, None, 3)


def _main(style: Style, rng: np.random.Generator) -> tuple[Profile, Side, Side]:
    lanes = 1 + int(rng.choice(len(style.lanes), p=style.lanes))
    centre = lanes > 1 and _chance(style.centre_turn, rng)
    profile = Profile(
        speed=float(rng.choice(style.limits)) * MPS_OF_MPH,
        width=rng.uniform(*style.widths),
        median=3.6 if centre else float(rng.choice(style.medians)) if lanes > 1 else 0.0,
        centre_turn=centre,
        parking=_chance(style.parking, rng),
        walks=_chance(style.walks, rng),
    )
    if _chance(style.one_way, rng):
        one_way = dataclasses.replace(profile, median=0.0, centre_turn=False)
        return (one_way, Side(max(lanes, 2)), Side(0))
    other = lanes if rng.random() < 0.85 else max(1, lanes - 1)
    return profile, Side(lanes), Side(other)


def _minor(style: Style, rng: np.random.Generator) -> tuple[Profile, Side, Side]:
    lanes = int(rng.choice([1, 2, 3], p=[0.45, 0.4, 0.15])) if len(style.lanes) > 2 else 1
    limit = float(rng.choice(style.limits[: max(1, len(style.limits) // 2)])) * MPS_OF_MPH
    profile = Profile(
        limit, rng.uniform(*style.widths), parking=_chance(style.parking, rng), walks=_chance(style.walks, rng)
    )
    if _chance(0.5 * style.one_way, rng):
        return profile, Side(lanes), Side(0)
    return profile, Side(lanes), Side(lanes)


def _with_pockets(side: Side, profile: Profile, style: Style, rng: np.random.Generator) -> Side:
    if not side.lanes or not _chance(style.pockets, rng):
        return side
    left = rng.uniform(28, 55) if profile.median >= _POCKET and not profile.centre_turn else 0.0
    right = rng.uniform(28, 50) if rng.random() < 0.4 else 0.0
    return dataclasses.replace(side, left_pocket=left, right_pocket=right)


def _free_line(rng: np.random.Generator, bend: float, speed: float) -> Line:
    """Through the origin or near it, ``2 REACH`` long: straight, or with one or two clothoid bends."""
    tightest = min(0.02, 2.0 / speed**2)  # comfortable at this speed [1/m]
    curve = rng.choice([-1, 1]) * rng.uniform(0.35, 1.0) * tightest * (bend > 0)
    other = -curve if rng.random() < 0.35 else curve * rng.uniform(0, 1)
    line = by_curvature([70, 30, 40, 40, 40, 80], [0, 0, curve, curve * 0.8, other, 0, 0])
    return line - line[len(line) // 2]


def _chance(share: float, rng: np.random.Generator) -> bool:
    return bool(rng.random() < share)


TOWNS = {
    "road": road, "crossing": crossing, "side streets": side_streets, "blocks": blocks, "roundabout": roundabout,
    "dead end": dead_end,
}  # fmt: skip
