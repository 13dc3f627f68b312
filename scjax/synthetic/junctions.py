"""Junctions at grade: how far roads stop from the middle, which lane may turn where, and the connectors."""

from __future__ import annotations

import numpy as np

from scjax.language.road import wrap_to_pi
from scjax.synthetic.curves import turn as turn_curve
from scjax.synthetic.network import Arm, Junction, Lane, Network, Turn

_STRAIGHT = np.deg2rad(38.0)  # a change of direction below this is none
_BACK = np.deg2rad(150.0)
_CAREFUL = 6.0  # m/s in turns
_NEAREST_STOP, _FARTHEST_STOP = 5.0, 34.0  # metres


def stop_distances(
    angles: list[float], arriving: list[float], leaving: list[float], corners: list[float]
) -> list[float]:
    """Where each arm ends, in metres from the middle, so that kerbs of neighbours meet with room for a corner.

    Args:
      angles: of the arms, ascending [rad]; arriving, leaving: width of their left and right half, seen outwards [m];
        corners: room at each arm [m].
    """
    reach = [_NEAREST_STOP] * len(angles)
    for i in range(len(angles)):
        j = (i + 1) % len(angles)
        gap = (angles[j] - angles[i]) % (2 * np.pi)
        if not np.deg2rad(15) < gap < np.deg2rad(165):
            continue
        sin, cos = np.sin(gap), np.cos(gap)
        reach[i] = max(reach[i], (leaving[j] + arriving[i] * cos) / sin + corners[i])
        reach[j] = max(reach[j], (arriving[i] + leaving[j] * cos) / sin + corners[j])
    return [float(min(value, _FARTHEST_STOP)) for value in reach]


def connect(net: Network, junction: Junction, rng: np.random.Generator) -> None:
    """Adds every connector that the junction's arms call for."""
    number = net.junctions.index(junction)
    for a, arm in enumerate(junction.arms):
        exits = _exits(junction.arms, a)
        for (lane, _), allowed in zip(arm.inbound, _allowed(arm, exits, rng), strict=True):
            for move in allowed:
                for other in exits[move]:
                    _join(net, junction, number, a, lane, move, junction.arms[other])


def _exits(arms: list[Arm], a: int) -> dict[Turn, list[int]]:
    """The other arms that can be left by, by the turn to them; at most one lies straight ahead."""
    heading = arms[a].angle + np.pi
    change = {b: wrap_to_pi(arm.angle - heading) for b, arm in enumerate(arms) if b != a and arm.outbound}
    found: dict[Turn, list[int]] = {"left": [], "through": [], "right": []}
    ahead = min(change, key=lambda b: abs(change[b]), default=None)
    for b, angle in change.items():
        if b == ahead and abs(angle) < _STRAIGHT:
            found["through"].append(b)
        elif abs(angle) < _BACK:
            found["left" if angle > 0 else "right"].append(b)
    return found


def _allowed(arm: Arm, exits: dict[Turn, list[int]], rng: np.random.Generator) -> list[list[Turn]]:
    """The turns that every inbound lane may take."""
    pockets: list[Turn | None] = [pocket for _, pocket in arm.inbound]
    count = len(pockets)
    found: list[list[Turn]] = []
    for pocket in pockets:
        found.append([pocket] if pocket is not None and exits[pocket] else [])
    plain = [k for k in range(count) if pockets[k] is None]
    if not plain:
        return found
    left = bool(exits["left"]) and "left" not in pockets
    right = bool(exits["right"]) and "right" not in pockets
    if not exits["through"]:
        # A stem: shared out between left and right.
        if left and right:
            middle = (len(plain) + 1) // 2
            for k, lane in enumerate(plain):
                if k < middle:
                    found[lane].append("left")
                if k >= middle or len(plain) == 1:
                    found[lane].append("right")
        else:
            either: Turn = "left" if exits["left"] else "right"
            for lane in plain if exits[either] else []:
                found[lane].append(either)
        return found
    for lane in plain:
        found[lane].append("through")
    if left:
        # Two lanes or more: the inner one is often for the left turn alone.
        if len(plain) > 1 and rng.random() < 0.4:
            found[plain[0]] = ["left"]
        else:
            found[plain[0]].insert(0, "left")
    if right:
        if len(plain) > 2 and rng.random() < 0.2:
            found[plain[-1]] = ["right"]
        else:
            found[plain[-1]].append("right")
    return found


def _join(net: Network, junction: Junction, number: int, a: int, lane: int, move: Turn, to: Arm) -> None:
    """The connector of one inbound lane to one arm: inner lanes to inner lanes, right turns into the outermost."""
    arm = junction.arms[a]
    lanes = [k for k, pocket in arm.inbound if pocket is None or move != "through"]
    leave = to.outbound[-1] if move == "right" else to.outbound[min(lanes.index(lane), len(to.outbound) - 1)]
    before, after = net.lanes[lane], net.lanes[leave]
    points = turn_curve(before.points, after.points)
    speed = min(before.speed, after.speed) if move == "through" else _CAREFUL + (move == "left") * 1.5
    precedence = arm.rank + {"through": 0, "right": 1, "left": 2}[move]
    made = net.add(
        Lane(
            points, speed, before.width, before.subtype, [leave], junction=number, turn=move, arm=a, entry=lane,
            rank=precedence, height=before.height,
        )
    )  # fmt: skip
    net.join(lane, made)
    junction.connectors.append(made)
