"""Motorways: carriageways, entries, exits, and roads that pass over them."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import Line, clothoid, cubic_curve, offset_line, slice_line, straight_line
from scjax.synthetic.network import MPS_PER_MPH, Junction, Lane, Network
from scjax.synthetic.roads import Carriageway, RoadProfile, add_road

_HALF_LENGTH = 190.0  # m
_BRIDGE_HEIGHT = 6.2  # m
_RAMP_SPEED = 18.0  # m/s
_MERGE_RADIUS = 10.0  # m
_ONE_WAY = Carriageway(0)


def build_motorway(rng: np.random.Generator) -> Network:
    """Two to four lanes through the origin, with an entry, an exit or neither; often the other carriageway."""
    net = Network()
    curvature = rng.normal(0, 0.0008)
    line = clothoid([2 * _HALF_LENGTH], [curvature, curvature])
    line = line - line[len(line) // 2]
    lanes = int(rng.choice([2, 3, 4], p=[0.45, 0.4, 0.15]))
    speed = float(rng.choice([55, 60, 65, 70])) * MPS_PER_MPH
    profile = RoadProfile(speed, rng.uniform(3.5, 3.75), subtype="freeway")
    ramp = rng.choice(["none", "entry", "exit"], p=[0.1, 0.55, 0.35])
    if ramp == "none":
        add_road(net, line, profile, Carriageway(lanes), _ONE_WAY)
    else:
        _add_road_with_ramp(net, line, profile, lanes, is_entry=ramp == "entry", rng=rng)
    if rng.random() < 0.75:
        gap = lanes * profile.width + rng.uniform(2, 9)
        opposite = offset_line(line, gap)[::-1]
        add_road(net, opposite, profile, Carriageway(int(rng.choice([lanes, max(2, lanes - 1)]))), _ONE_WAY)
    if rng.random() < 0.3:
        _add_overpass(net, line, rng)
    return net


def _add_road_with_ramp(
    net: Network, line: Line, profile: RoadProfile, lanes: int, is_entry: bool, rng: np.random.Generator
) -> None:
    """Adds the motorway with one more lane on the right: a ramp leads into it and it ends, or the reverse."""
    extra_length = rng.uniform(90, 140)
    cut = _HALF_LENGTH + rng.uniform(-40, 40) - (extra_length / 2 if is_entry else -extra_length / 2)
    before, after = slice_line(line, 0.0, cut), slice_line(line, cut, 2 * _HALF_LENGTH)
    exit_road = Carriageway(lanes, right_pocket=0.0 if is_entry else extra_length)
    entry_road = Carriageway(lanes, ending=extra_length if is_entry else 0.0)
    first, _ = add_road(net, before, profile, exit_road, _ONE_WAY)
    second, _ = add_road(net, after, profile, entry_road, _ONE_WAY)
    through_lanes = [lane for lane, pocket in first.end if pocket is None]
    for lane, successor in zip(through_lanes, second.start, strict=False):
        net.lanes[successor].points[0] = net.lanes[lane].points[-1]
        net.link(lane, successor)
        net.lanes[successor].points[0] = net.lanes[lane].points[-1]
    if is_entry and len(second.start) > lanes:
        lane = second.start[-1]
        points = _draw_ramp(net.lanes[lane].points, rng)[::-1]
        ramp = net.add_lane(Lane(points, _RAMP_SPEED, profile.width, "freeway", [lane], at_curb=True))
        center = net.lanes[ramp].points[-1]
    elif not is_entry and len(first.end) > lanes:
        lane = first.end[-1][0]
        points = _draw_ramp(net.lanes[lane].points[::-1], rng, side=-1.0)
        ramp = net.add_lane(Lane(points, _RAMP_SPEED, profile.width, "freeway", at_curb=True))
        net.link(lane, ramp)
        center = net.lanes[ramp].points[0]
    else:
        return
    net.junctions.append(Junction("merge", center, _MERGE_RADIUS, []))


def _draw_ramp(lane: Line, rng: np.random.Generator, side: float = 1.0) -> Line:
    """A curve from the first point of ``lane``, against its direction and to its right (``side`` -1: to its left)."""
    ahead = lane[1] - lane[0]
    ahead = ahead / np.hypot(*ahead)
    right = side * np.array([ahead[1], -ahead[0]])
    end = lane[0] - rng.uniform(90, 130) * ahead + rng.uniform(18, 32) * right
    end_direction = rng.uniform(0.1, 0.5) * right - ahead
    start_heading = float(np.arctan2(-ahead[1], -ahead[0]))
    return cubic_curve(lane[0], start_heading, end, float(np.arctan2(end_direction[1], end_direction[0])))


def _add_overpass(net: Network, line: Line, rng: np.random.Generator) -> None:
    """Adds a road on another level that crosses the motorway."""
    heading = np.pi / 2 + rng.normal(0, 0.2)
    center = line[len(line) // 2] + np.array([rng.uniform(-50, 50), 0.0])
    start = center - 120.0 * np.array([np.cos(heading), np.sin(heading)])
    profile = RoadProfile(35 * MPS_PER_MPH, 3.5, height=_BRIDGE_HEIGHT)
    forward, backward = Carriageway(int(rng.integers(1, 3))), Carriageway(int(rng.integers(1, 3)))
    add_road(net, straight_line(start, heading, 240.0), profile, forward, backward)
