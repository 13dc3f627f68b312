"""Random plans of street networks around the origin: road, intersection, side streets, blocks, roundabout, dead end."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.synthetic.curves import clothoid, straight_line, transform_line
from scjax.synthetic.network import MPS_PER_MPH
from scjax.synthetic.plan import PlanEdge, PlanNode, RoadPlan
from scjax.synthetic.roads import Carriageway, RoadProfile
from scjax.synthetic.streets import (
    CORNERS,
    MAP_RADIUS,
    SIDE_STREET_RANK,
    SIDE_STREET_SPACING,
    Street,
    StreetStyle,
    add_arms,
    add_road_with_side_streets,
    draw_bool,
    draw_main_street,
    draw_minor_street,
    draw_road_line,
    draw_skew,
    draw_winding_line,
)

_CHANGE_SHARE = 0.7  # of roads with a lane that starts or ends
_FOUR_ARMS_SHARE, _SKEW_SHARE = 0.55, 0.25
_TWO_LANE_RING_SHARE = 0.35
_TURNING_CIRCLE_SHARE, _TURNING_CIRCLES = 0.4, (7.0, 9.0)  # of dead ends; radii [m]
_LATERAL_ACCELERATION = 2.5  # m/s^2, comfortable in bends


def plan_road(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """One road without junctions: straight, curved or winding; a lane may start or end on it."""
    profile, forward, backward = draw_main_street(style, rng)
    if rng.random() < _CHANGE_SHARE:
        change = str(rng.choice(["right_pocket", "ending"], p=[0.2, 0.8]))
        forward = dataclasses.replace(forward, **{change: rng.uniform(110, 190)})
    line = draw_road_line(rng, has_bends=bool(rng.random() < style.bends + 0.25), speed=profile.speed)
    return RoadPlan(edges=[PlanEdge(line, profile, forward, backward)])


def plan_winding_road(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """One road with bends to both sides, driven at a speed that suits them."""
    profile, forward, backward = draw_minor_street(style, rng)
    min_radius = rng.uniform(32, 75)
    profile = dataclasses.replace(profile, speed=min(profile.speed, float(np.sqrt(_LATERAL_ACCELERATION * min_radius))))
    return RoadPlan(edges=[PlanEdge(draw_winding_line(rng, min_radius), profile, forward, backward)])


def plan_intersection(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """A four-way or T-junction, of narrow roads also a skew one, often with further junctions on its arms."""
    plan = RoadPlan([PlanNode(np.zeros(2), bool(rng.random() < style.signals), corner=rng.uniform(*CORNERS))])
    main_street = draw_main_street(style, rng)
    cross_street = draw_main_street(style, rng) if rng.random() < 0.6 else draw_minor_street(style, rng)
    is_narrow = max(main_street.forward.lanes, cross_street.forward.lanes) == 1
    is_skew = is_narrow and rng.random() < _SKEW_SHARE
    cross = np.pi / 2 + (rng.choice([-1, 1]) * rng.uniform(0.3, 0.6) if is_skew else draw_skew(rng))
    arms = 4 if rng.random() < _FOUR_ARMS_SHARE else 3
    angles = np.array([0.0, np.pi, cross, cross - np.pi][:arms]) + rng.normal(0, 0.03)
    if arms == 3 and (rng.random() < 0.5 or not main_street.backward.lanes):
        angles = -angles  # on a one-way road from the right, where ways in and out do not cross
    add_arms(plan, 0, angles, [main_street, main_street, cross_street, cross_street], style, rng)
    return plan


def plan_y_junction(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """Three narrow roads that meet at about equal angles."""
    style = dataclasses.replace(style, lanes=(1.0,), one_way=0.0)
    plan = RoadPlan([PlanNode(np.zeros(2), bool(rng.random() < style.signals / 2), corner=rng.uniform(*CORNERS))])
    angles = np.arange(3) * 2 * np.pi / 3 + rng.normal(0, 0.12, 3)
    street = draw_minor_street(style, rng)
    add_arms(plan, 0, angles, [street] * 3, style, rng)
    return plan


def plan_side_streets(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """A road with streets and driveways that end on it."""
    profile, forward, backward = draw_main_street(style, rng)
    line = draw_road_line(rng, has_bends=bool(rng.random() < style.bends), speed=profile.speed)
    positions = np.cumsum(rng.uniform(*SIDE_STREET_SPACING, int(rng.integers(4, 9)))) + rng.uniform(40, 90)
    plan = RoadPlan()
    road = PlanEdge(line, profile, forward, backward)
    add_road_with_side_streets(plan, road, positions[positions < 2 * MAP_RADIUS - 60], [], rng)
    return plan


def plan_blocks(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """Two by two junctions of a grid; some streets are one-way."""
    spacing = rng.uniform(62, 105, 2)
    corners = [np.array([x, y]) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    has_signals = bool(rng.random() < style.signals)
    plan = RoadPlan([PlanNode(spacing * corner, has_signals, corner=rng.uniform(*CORNERS)) for corner in corners])
    streets = [draw_main_street(style, rng) if rng.random() < 0.4 else draw_minor_street(style, rng) for _ in range(4)]
    for k, (profile, forward, backward) in enumerate(streets):
        # Streets 0 and 1 run along y at the two x, streets 2 and 3 along x at the two y.
        first, second = ((0, 1), (2, 3), (0, 2), (1, 3))[k]
        heading = np.pi / 2 if k < 2 else 0.0
        a, b = plan.nodes[first].center, plan.nodes[second].center
        rank = SIDE_STREET_RANK * (k % 2)
        between = straight_line(a, heading, float(np.hypot(*(b - a))))
        plan.edges.append(PlanEdge(between, profile, forward, backward, first, second, rank))
        length = MAP_RADIUS - float(np.abs(a).max())
        after, before = straight_line(b, heading, length), straight_line(a, heading + np.pi, length)
        plan.edges.append(PlanEdge(after, profile, forward, backward, second, None, rank))
        plan.edges.append(PlanEdge(before, profile, backward, forward, first, None, rank))
    return plan


def plan_roundabout(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """Three or four arms on a ring of one or two lanes."""
    count = int(rng.choice([3, 4], p=[0.35, 0.65]))
    lanes = 2 if len(style.lanes) > 2 and rng.random() < _TWO_LANE_RING_SHARE else 1
    plan = RoadPlan([PlanNode(np.zeros(2), ring_radius=float(rng.uniform(13.0, 18.0)), ring_lanes=lanes)])
    angles = np.arange(count) * 2 * np.pi / count + rng.normal(0, 0.08, count)
    limit = float(rng.choice(style.limits)) * MPS_PER_MPH
    median, sidewalk = float(rng.choice([0.0, 1.5])), draw_bool(style.sidewalks, rng)
    profile = RoadProfile(limit, rng.uniform(*style.widths), median=median, sidewalk=sidewalk)
    add_arms(plan, 0, angles, [Street(profile, Carriageway(lanes), Carriageway(lanes))] * count, style, rng)
    return plan


def plan_dead_end(style: StreetStyle, rng: np.random.Generator) -> RoadPlan:
    """A residential street that starts on another one and ends within view."""
    plan = RoadPlan([PlanNode(np.zeros(2), corner=6.5)])
    profile, forward, backward = draw_minor_street(style, rng)
    profile = dataclasses.replace(profile, parking=True)
    side = 1 if backward.lanes else -1
    angles = np.array([0.0, np.pi, side * np.pi / 2 + draw_skew(rng)])
    add_arms(plan, 0, angles[:2], [Street(profile, forward, backward)] * 2, style, rng)
    line = clothoid([25, rng.uniform(20, 60)], [0, 0, rng.normal(0, 0.006)])
    line = transform_line(line, np.zeros(2), float(angles[2]))
    profile = dataclasses.replace(profile, speed=20 * MPS_PER_MPH)
    circle = rng.uniform(*_TURNING_CIRCLES) if rng.random() < _TURNING_CIRCLE_SHARE else 0.0
    dead_end = PlanEdge(line, profile, Carriageway(1), Carriageway(1), 0, None, SIDE_STREET_RANK, circle)
    plan.edges.append(dead_end)
    return plan
