"""Motorways: carriageways, entries, exits, and roads that pass over them."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import Line, by_curvature, offset, part, spline, straight
from scjax.synthetic.network import MPS_OF_MPH, Junction, Lane, Network
from scjax.synthetic.roads import Profile, Side, add_road

_HALF = 190.0  # metres
_CLEARANCE = 6.2  # metres between the levels of a crossing
_RAMP_SPEED = 18.0  # m/s


def motorway(rng: np.random.Generator) -> Network:
    """Two to four lanes through the origin, with an entry, an exit or neither; the other carriageway if it is near."""
    net = Network()
    bend = rng.normal(0, 0.0008)
    line = by_curvature([2 * _HALF], [bend, bend])
    line = line - line[len(line) // 2]
    lanes = int(rng.choice([2, 3, 4], p=[0.45, 0.4, 0.15]))
    profile = Profile(
        float(rng.choice([55, 60, 65, 70])) * MPS_OF_MPH, rng.uniform(3.5, 3.75), 0.0, "freeway", walks=False
    )
    kind = rng.choice(["plain", "entry", "exit"], p=[0.3, 0.4, 0.3])
    if kind == "plain":
        add_road(net, line, profile, Side(lanes), Side(0))
    else:
        _with_ramp(net, line, profile, lanes, entry=kind == "entry", rng=rng)
    if rng.random() < 0.75:
        gap = lanes * profile.width + rng.uniform(2, 9)
        far = offset(line, gap)[::-1]
        add_road(net, far, profile, Side(int(rng.choice([lanes, max(2, lanes - 1)]))), Side(0))
    if rng.random() < 0.3:
        _overpass(net, line, rng)
    return net


def _with_ramp(net: Network, line: Line, profile: Profile, lanes: int, entry: bool, rng: np.random.Generator) -> None:
    """A lane beside the right one: fed by a ramp and ending, or beginning and leaving on a ramp."""
    beside = rng.uniform(90, 140)
    joint = _HALF + rng.uniform(-40, 40) - (beside / 2 if entry else -beside / 2)
    before, after = part(line, 0.0, joint), part(line, joint, 2 * _HALF)
    first, _ = add_road(net, before, profile, Side(lanes, right_pocket=0.0 if entry else beside), Side(0))
    then, _ = add_road(net, after, profile, Side(lanes, ending=beside if entry else 0.0), Side(0))
    main = [lane for lane, pocket in first.last if pocket is None]
    for a, b in zip(main, then.first, strict=False):
        net.join(a, b)
    if entry and len(then.first) > lanes:
        lane = then.first[-1]
        points = _ramp(net.lanes[lane].points, rng)[::-1]
        ramp = net.add(Lane(points, _RAMP_SPEED, profile.width, "freeway", [lane], kerb=True))
    elif not entry and len(first.last) > lanes:
        lane = first.last[-1][0]
        points = _ramp(net.lanes[lane].points[::-1], rng, right=-1.0)
        ramp = net.add(Lane(points, _RAMP_SPEED, profile.width, "freeway", kerb=True))
        net.join(lane, ramp)
    else:
        return
    net.junctions.append(Junction("merge", net.lanes[ramp].points[-1 if entry else 0], 10.0, []))


def _ramp(lane: Line, rng: np.random.Generator, right: float = 1.0) -> Line:
    """From the first point of ``lane``, away from it: backwards, then to its right (-1: to its left)."""
    ahead = lane[1] - lane[0]
    ahead = ahead / np.hypot(*ahead)
    side = right * np.array([ahead[1], -ahead[0]])
    end = lane[0] - rng.uniform(90, 130) * ahead + rng.uniform(18, 32) * side
    into = rng.uniform(0.1, 0.5) * side - ahead
    return spline(lane[0], float(np.arctan2(-ahead[1], -ahead[0])), end, float(np.arctan2(into[1], into[0])))


def _overpass(net: Network, line: Line, rng: np.random.Generator) -> None:
    """A road across, on another level."""
    angle = np.pi / 2 + rng.normal(0, 0.2)
    middle = line[len(line) // 2] + np.array([rng.uniform(-50, 50), 0.0])
    start = middle - 120.0 * np.array([np.cos(angle), np.sin(angle)])
    profile = Profile(35 * MPS_OF_MPH, 3.5, walks=False, height=_CLEARANCE)
    add_road(net, straight(start, angle, 240.0), profile, Side(int(rng.integers(1, 3))), Side(int(rng.integers(1, 3))))
