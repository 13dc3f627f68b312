"""Motorways: carriageways that entries, exits, forks and joins change, and roads that pass over them."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import Line, clothoid, cubic_curve, offset_line, slice_line, straight_line, transform_line
from scjax.synthetic.network import MPS_PER_MPH, Junction, Lane, Network
from scjax.synthetic.roads import Carriageway, RoadProfile, add_road

_HALF_LENGTH = 190.0  # m
_BRIDGE_HEIGHT = 6.2  # m
_RAMP_SPEED = 18.0  # m/s
_MERGE_RADIUS = 10.0  # m
_LANES = {2: 0.38, 3: 0.35, 4: 0.17, 5: 0.1}
_CHANGES = {"none": 0.05, "entry": 0.6, "exit": 0.1, "fork": 0.1, "join": 0.15}
_TAPER_ENTRIES = 0.75  # share of the entries that merge at once, without a lane beside the motorway
_FORK_CURVATURE = (1 / 700, 1 / 300)  # 1/m, of both branches
_OVERPASSES = 0.3  # share
_ONE_WAY = Carriageway(0)


def build_motorway(rng: np.random.Generator) -> Network:
    """Two to five lanes through the origin that change there or not; often the other carriageway."""
    net = Network()
    curvature = rng.normal(0, 0.0008)
    line = clothoid([2 * _HALF_LENGTH], [curvature, curvature])
    line = line - line[len(line) // 2]
    lanes = int(rng.choice(list(_LANES), p=list(_LANES.values())))
    speed = float(rng.choice([55, 60, 65, 70])) * MPS_PER_MPH
    profile = RoadProfile(speed, rng.uniform(3.5, 3.75), subtype="freeway")
    change = str(rng.choice(list(_CHANGES), p=list(_CHANGES.values())))
    if change == "none":
        add_road(net, line, profile, Carriageway(lanes), _ONE_WAY)
    elif change in ("entry", "exit"):
        _add_road_with_ramp(net, line, profile, lanes, is_entry=change == "entry", rng=rng)
    else:
        _add_forked_road(net, line, profile, lanes, is_fork=change == "fork", rng=rng)
    if change not in ("fork", "join") and rng.random() < 0.75:
        gap = lanes * profile.width + rng.uniform(2, 9)
        opposite = offset_line(line, gap)[::-1]
        add_road(net, opposite, profile, Carriageway(int(rng.choice([lanes, max(2, lanes - 1)]))), _ONE_WAY)
    if rng.random() < _OVERPASSES:
        _add_overpass(net, line, rng)
    return net


def _add_road_with_ramp(
    net: Network, line: Line, profile: RoadProfile, lanes: int, is_entry: bool, rng: np.random.Generator
) -> None:
    """Adds the motorway with one more lane on the right: a ramp leads into it and it ends, or the reverse."""
    is_taper = is_entry and rng.random() < _TAPER_ENTRIES
    extra_length = rng.uniform(38, 60) if is_taper else rng.uniform(90, 140)
    cut = _HALF_LENGTH + rng.uniform(-40, 40) - (extra_length / 2 if is_entry else -extra_length / 2)
    first, second = _add_two_sections(net, line, cut, profile, lanes, extra_length, is_entry)
    if is_entry and len(second) > lanes:
        lane = second[-1]
        points = _draw_ramp(net.lanes[lane].points, rng)[::-1]
        ramp = net.add_lane(Lane(points, _RAMP_SPEED, profile.width, "freeway", [lane], at_curb=True))
        _mark_merge(net, net.lanes[ramp].points[-1])
    elif not is_entry and len(first) > lanes:
        lane = first[-1]
        points = _draw_ramp(net.lanes[lane].points[::-1], rng, side=-1.0)
        ramp = net.add_lane(Lane(points, _RAMP_SPEED, profile.width, "freeway", at_curb=True))
        net.link(lane, ramp)
        _mark_merge(net, net.lanes[ramp].points[0])


def _add_two_sections(
    net: Network, line: Line, cut: float, profile: RoadProfile, lanes: int, extra_length: float, is_entry: bool
) -> tuple[list[int], list[int]]:
    """Adds the motorway in two sections, of which one has one more lane on the right at their joint.

    Returns:
      The lanes that end and those that begin at the joint, from the left.
    """
    before, after = slice_line(line, 0.0, cut), slice_line(line, cut, 2 * _HALF_LENGTH)
    exit_road = Carriageway(lanes, right_pocket=0.0 if is_entry else extra_length)
    entry_road = Carriageway(lanes, ending=extra_length if is_entry else 0.0)
    first, _ = add_road(net, before, profile, exit_road, _ONE_WAY)
    second, _ = add_road(net, after, profile, entry_road, _ONE_WAY)
    arriving = [lane for lane, _ in first.end]
    _link_in_order(net, arriving[:lanes], second.start[:lanes])
    return arriving, second.start


def _add_forked_road(
    net: Network, line: Line, profile: RoadProfile, lanes: int, is_fork: bool, rng: np.random.Generator
) -> None:
    """Adds a motorway that gains a lane and splits into two, or two that join and lose a lane."""
    extra_length = rng.uniform(60, 110)
    cut = _HALF_LENGTH + rng.uniform(-40, 40) + (extra_length / 2 if is_fork else -extra_length / 2)
    trunk_line = slice_line(line, 0.0, cut) if is_fork else slice_line(line, cut, 2 * _HALF_LENGTH)
    extra = {"right_pocket" if is_fork else "ending": extra_length}
    trunk, _ = add_road(net, trunk_line, profile, Carriageway(lanes, **extra), _ONE_WAY)
    trunk_lanes = [lane for lane, _ in trunk.end] if is_fork else trunk.start
    origin, outwards = (
        (trunk_line[-1], trunk_line[-1] - trunk_line[-2])
        if is_fork
        else (
            trunk_line[0],
            trunk_line[0] - trunk_line[1],
        )
    )
    heading = float(np.arctan2(outwards[1], outwards[0]))
    side = 1.0 if is_fork else -1.0  # the left branch bends to the left of the traffic
    right_of_traffic = side * np.array([np.sin(heading), -np.cos(heading)])
    num_left = int(rng.integers(1, len(trunk_lanes)))
    for k, (low, high) in enumerate(((0, num_left), (num_left, len(trunk_lanes)))):
        curvature = (1 - 2 * k) * side * rng.uniform(*_FORK_CURVATURE)
        branch = clothoid([30, _HALF_LENGTH - 30], [0, curvature, curvature])
        branch = transform_line(branch, origin + low * profile.width * right_of_traffic, heading)
        ends, _ = add_road(net, branch if is_fork else branch[::-1], profile, Carriageway(high - low), _ONE_WAY)
        if is_fork:
            _link_in_order(net, trunk_lanes[low:high], ends.start)
        else:
            _link_in_order(net, [lane for lane, _ in ends.end], trunk_lanes[low:high])
    _mark_merge(net, origin)


def _link_in_order(net: Network, arriving: list[int], leaving: list[int]) -> None:
    """Links lanes one by one, without a gap."""
    for lane, successor in zip(arriving, leaving, strict=True):
        net.link(lane, successor)
        net.lanes[successor].points[0] = net.lanes[lane].points[-1]


def _mark_merge(net: Network, center: np.ndarray) -> None:
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
