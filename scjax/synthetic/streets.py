"""Streets of a domain: random cross-sections, and roads with streets and driveways that end on them."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from scjax.synthetic.curves import Line, clothoid, straight_line, transform_line
from scjax.synthetic.network import MPS_PER_MPH
from scjax.synthetic.plan import PlanEdge, PlanNode, RoadPlan
from scjax.synthetic.roads import Carriageway, RoadProfile

MAP_RADIUS = 150.0  # m from the center to the border of the map
SIDE_STREET_RANK = 3
_RIGHT_ANGLE_SHARE, _SKEWS = 0.75, (0.015, 0.1)  # rad, standard deviations
_MIN_ROAD_DISTANCE = 16.0  # m between the reference lines of roads that do not meet
_MIN_POCKET_MEDIAN = 3.0  # m of median that a left-turn pocket needs
CORNERS = (3.2, 7.0)  # m, radii of the curbs
_DRIVEWAY_CORNERS = (3.2, 4.5)  # m
_DRIVEWAY_SHARE = 0.34
_AISLE_SHARE = 0.25  # of driveways that end on an aisle
_AISLE_LENGTHS = (14, 34)  # m, to each side
_BOTH_SIDES_SHARE = 0.2  # of the places where streets end on a road from both sides
SIDE_STREET_SPACING = (20, 55)  # m
_BEND_TRANSITION = 10.0  # m from straight to the full curvature of a bend
_MIN_BORDER_DISTANCE = 35  # m between a side street and the border of the map


@dataclasses.dataclass(frozen=True)
class StreetStyle:
    """What the streets of a domain are like.

    Attributes:
      limits: speed limits [mph], drawn with equal probabilities.
      widths: range of lane widths [m].
      lanes: probabilities of 1, 2, ... lanes per direction on main roads.
      medians: widths [m], drawn with equal probabilities.
      one_way, parking, sidewalks, signals, pockets: shares of roads or junctions with the feature.
      bends: share of roads with a bend.
      branches: probabilities of 0, 1, 2, ... side streets on an arm of a junction.
    """

    limits: tuple[int, ...]
    widths: tuple[float, float]
    lanes: tuple[float, ...]
    medians: tuple[float, ...]
    one_way: float = 0.0
    parking: float = 0.0
    sidewalks: float = 1.0
    signals: float = 0.6
    pockets: float = 0.5
    bends: float = 0.3
    branches: tuple[float, ...] = (0.25, 0.31, 0.26, 0.12, 0.06)


class Street(NamedTuple):
    """Cross-section of a street."""

    profile: RoadProfile
    forward: Carriageway
    backward: Carriageway


def draw_main_street(style: StreetStyle, rng: np.random.Generator) -> Street:
    """Random cross-section of a main road."""
    lanes = 1 + int(rng.choice(len(style.lanes), p=style.lanes))
    profile = RoadProfile(
        speed=float(rng.choice(style.limits)) * MPS_PER_MPH,
        width=rng.uniform(*style.widths),
        median=float(rng.choice(style.medians)) if lanes > 1 else 0.0,
        parking=draw_bool(style.parking, rng),
        sidewalk=draw_bool(style.sidewalks, rng),
    )
    if draw_bool(style.one_way, rng):
        profile = dataclasses.replace(profile, median=0.0)
        return Street(profile, Carriageway(max(lanes, 2)), Carriageway(0))
    backward_lanes = lanes if rng.random() < 0.85 else max(1, lanes - 1)
    return Street(profile, Carriageway(lanes), Carriageway(backward_lanes))


def draw_minor_street(style: StreetStyle, rng: np.random.Generator) -> Street:
    """Random cross-section of a minor road: fewer lanes and one of the lower speed limits."""
    lanes = int(rng.choice([1, 2, 3], p=[0.45, 0.4, 0.15])) if len(style.lanes) > 2 else 1
    limit = float(rng.choice(style.limits[: max(1, len(style.limits) // 2)])) * MPS_PER_MPH
    profile = RoadProfile(
        limit,
        rng.uniform(*style.widths),
        parking=draw_bool(style.parking, rng),
        sidewalk=draw_bool(style.sidewalks, rng),
    )
    is_one_way = draw_bool(0.5 * style.one_way, rng)
    return Street(profile, Carriageway(lanes), Carriageway(0 if is_one_way else lanes))


def draw_road_line(rng: np.random.Generator, has_bends: bool, speed: float) -> Line:
    """A line of length ``2 * MAP_RADIUS`` around the origin, straight or with bends that suit ``speed`` [m/s]."""
    max_curvature = min(0.02, 2.0 / speed**2)  # 1/m
    curvature = rng.choice([-1, 1]) * rng.uniform(0.35, 1.0) * max_curvature * has_bends
    second = -curvature if rng.random() < 0.35 else curvature * rng.uniform(0, 1)
    line = clothoid([70, 30, 40, 40, 40, 80], [0, 0, curvature, curvature * 0.8, second, 0, 0])
    return line - line[len(line) // 2]


def draw_winding_line(rng: np.random.Generator, min_radius: float) -> Line:
    """A line of about ``2 * MAP_RADIUS`` with bends to both sides, of radii from ``min_radius`` [m]."""
    lengths, curvatures, side = [], [0.0], float(rng.choice([-1, 1]))
    while sum(lengths) < 2 * MAP_RADIUS:
        curvature = side * rng.uniform(0.6, 1.0) / min_radius
        lengths += [_BEND_TRANSITION, rng.uniform(8, 22), _BEND_TRANSITION]
        curvatures += [curvature, curvature, 0.0]
        side = -side
    line = clothoid(lengths, curvatures)
    return line - line[len(line) // 2]


def add_arms(
    plan: RoadPlan, node: int, angles: np.ndarray, streets: list[Street], style: StreetStyle, rng: np.random.Generator
) -> None:
    """Adds roads outwards from a node, with side streets and driveways on them.

    Args:
      angles: directions of the roads [rad], the two of the main road first.
      streets: cross-sections of the roads; the second arm of a street sees its carriageways swapped.
    """
    lines = []
    for angle in angles:
        curvature = rng.normal(0, 0.006) if rng.random() < style.bends else 0.0
        line = clothoid([45, 30, MAP_RADIUS - 75], [0, 0, curvature, curvature])
        lines.append(transform_line(line, plan.nodes[node].center, float(angle)))
    for k, (profile, forward, backward) in enumerate(streets[: len(lines)]):
        if k % 2:
            forward, backward = backward, forward
        backward = _add_pockets(backward, profile, style, rng)
        count = int(rng.choice(len(style.branches), p=style.branches))
        positions = np.cumsum(rng.uniform(*SIDE_STREET_SPACING, count)) + rng.uniform(12, 28)
        others = [line for j, line in enumerate(lines) if j != k]
        rank = 0 if k < 2 else SIDE_STREET_RANK
        road = PlanEdge(lines[k], profile, forward, backward, node, None, rank)
        positions = positions[positions < MAP_RADIUS - _MIN_BORDER_DISTANCE]
        lines += add_road_with_side_streets(plan, road, positions, others, rng)


def add_road_with_side_streets(
    plan: RoadPlan, road: PlanEdge, positions: np.ndarray, others: list[Line], rng: np.random.Generator
) -> list[Line]:
    """Adds ``road``, with streets and driveways that end on it.

    Args:
      positions: of the side streets along the road [m].
      others: lines that side streets keep clear of.

    Returns:
      Reference lines of the side streets. Turn pockets of ``road.backward`` stay at the start of the road only.
    """
    line, side_lines = road.line, []
    spacing = float(np.hypot(*(line[1] - line[0])))
    start_node, start, backward = road.start_node, 0, road.backward
    is_one_way = not (road.forward.lanes and road.backward.lanes)
    half_width = max(side.half_width(road.profile, arriving=True) for side in (road.forward, road.backward))
    for position in positions:
        point = round(position / spacing)
        is_driveway = bool(rng.random() < _DRIVEWAY_SHARE)
        tangent = line[point + 1] - line[point - 1]
        sides = rng.permutation([-1.0, 1.0])[: 2 if rng.random() < _BOTH_SIDES_SHARE else 1]
        if is_one_way:  # from the right, where ways in and out do not cross
            sides = [-1.0 if road.forward.lanes else 1.0]
        side_streets = []
        for sign in sides:
            angle = float(np.arctan2(tangent[1], tangent[0])) + sign * (np.pi / 2 + draw_skew(rng))
            side_street = _draw_side_street(line[point], angle, is_driveway, half_width, len(plan.nodes), rng)
            if _is_clear(side_street.line, others + side_lines):
                side_streets.append(side_street)
        if not side_streets:
            continue
        number = len(plan.nodes)
        corner = rng.uniform(*(_DRIVEWAY_CORNERS if is_driveway else CORNERS))
        plan.nodes.append(PlanNode(line[point], corner=corner, is_driveway=is_driveway))
        plan.edges += side_streets
        for side_street in side_streets:
            aisles = _draw_aisles(side_street, others + side_lines, rng) if is_driveway else []
            side_lines.append(side_street.line)
            if aisles:
                side_street.end_node = len(plan.nodes)
                plan.nodes.append(PlanNode(side_street.line[-1], corner=_DRIVEWAY_CORNERS[0], is_driveway=True))
                plan.edges += [dataclasses.replace(aisle, start_node=side_street.end_node) for aisle in aisles]
                side_lines += [aisle.line for aisle in aisles]
        stretch = line[start : point + 1]
        plan.edges.append(
            dataclasses.replace(road, line=stretch, backward=backward, start_node=start_node, end_node=number)
        )
        start_node, start = number, point
        backward = dataclasses.replace(road.backward, left_pocket=0.0, right_pocket=0.0)
    plan.edges.append(dataclasses.replace(road, line=line[start:], backward=backward, start_node=start_node))
    return side_lines


def draw_skew(rng: np.random.Generator) -> float:
    """Deviation of a street from a right angle to the other one [rad]; most streets have nearly none."""
    return float(rng.normal(0, _SKEWS[0] if rng.random() < _RIGHT_ANGLE_SHARE else _SKEWS[1]))


def draw_bool(probability: float, rng: np.random.Generator) -> bool:
    """True with ``probability``."""
    return bool(rng.random() < probability)


def _is_clear(line: Line, others: list[Line]) -> bool:
    """Whether a line keeps its distance from all others."""
    squares = (np.square(line[:, None] - other[None]).sum(-1) for other in others)
    return all(square.min() > _MIN_ROAD_DISTANCE**2 for square in squares)


def _draw_side_street(
    start: np.ndarray, angle: float, is_driveway: bool, half_width: float, node: int, rng: np.random.Generator
) -> PlanEdge:
    """A street or driveway that starts on a road whose edge is ``half_width`` [m] away."""
    length = half_width + (rng.uniform(16, 36) if is_driveway else rng.uniform(75, 115))
    profile = RoadProfile(
        (10 if is_driveway else 25) * MPS_PER_MPH,
        3.0 if is_driveway else 3.3,
        parking=not is_driveway and rng.random() < 0.3,
        sidewalk=not is_driveway,
    )
    line = transform_line(clothoid([20, length - 20], [0, 0, rng.normal(0, 0.004)]), start, angle)
    return PlanEdge(line, profile, Carriageway(1), Carriageway(1), node, None, SIDE_STREET_RANK)


def _draw_aisles(driveway: PlanEdge, others: list[Line], rng: np.random.Generator) -> list[PlanEdge]:
    """Sometimes two aisles, to the left and to the right of the end of a driveway."""
    if rng.random() > _AISLE_SHARE:
        return []
    ahead = driveway.line[-1] - driveway.line[-2]
    heading = float(np.arctan2(ahead[1], ahead[0]))
    lines = [
        straight_line(driveway.line[-1], heading + side * np.pi / 2, rng.uniform(*_AISLE_LENGTHS)) for side in (-1, 1)
    ]
    if not all(_is_clear(line, others) for line in lines):
        return []
    return [dataclasses.replace(driveway, line=line, start_node=None) for line in lines]


def _add_pockets(
    carriageway: Carriageway, profile: RoadProfile, style: StreetStyle, rng: np.random.Generator
) -> Carriageway:
    """The carriageway with random turn pockets."""
    if not carriageway.lanes or not draw_bool(style.pockets, rng):
        return carriageway
    left = rng.uniform(32, 75) if profile.median >= _MIN_POCKET_MEDIAN else 0.0
    right = rng.uniform(30, 75) if rng.random() < 0.55 else 0.0
    return dataclasses.replace(carriageway, left_pocket=left, right_pocket=right)
