"""Junctions at grade: stop lines, the turns that each lane allows, and the connectors."""

from __future__ import annotations

import numpy as np

from scjax.language.road import wrap_to_pi
from scjax.synthetic.curves import turn_curve
from scjax.synthetic.network import Arm, Junction, Lane, Network, Turn

_MAX_STRAIGHT_ANGLE = np.deg2rad(38.0)
_MAX_TURN_ANGLE = np.deg2rad(150.0)  # larger changes of direction are U-turns
_CORNER_ANGLES = np.deg2rad((15.0, 165.0))  # between neighboring arms that share a corner
_RIGHT_TURN_SPEED, _LEFT_TURN_SPEED = 6.0, 7.5  # m/s
_MIN_STOP_DISTANCE, _MAX_STOP_DISTANCE = 5.0, 34.0  # m
_TURN_RANK = {"through": 0, "right": 1, "left": 2}
_LEFT_ONLY_SHARE, _RIGHT_ONLY_SHARE = 0.4, 0.2  # of junctions with lanes for one turn only


def stop_distances(
    angles: list[float], arriving: list[float], leaving: list[float], corners: list[float]
) -> list[float]:
    """Distances of the stop lines from the center, so that neighboring roads do not overlap [m].

    Args:
      angles: directions of the arms, ascending [rad].
      arriving, leaving: half widths of each arm on the side of the lanes that arrive and that leave [m].
      corners: room between the corner and the stop line of each arm [m].
    """
    distances = [_MIN_STOP_DISTANCE] * len(angles)
    for i in range(len(angles)):
        j = (i + 1) % len(angles)
        gap = (angles[j] - angles[i]) % (2 * np.pi)
        if not _CORNER_ANGLES[0] < gap < _CORNER_ANGLES[1]:
            continue
        sin, cos = np.sin(gap), np.cos(gap)
        distances[i] = max(distances[i], (leaving[j] + arriving[i] * cos) / sin + corners[i])
        distances[j] = max(distances[j], (arriving[i] + leaving[j] * cos) / sin + corners[j])
    return [float(min(distance, _MAX_STOP_DISTANCE)) for distance in distances]


def add_connectors(net: Network, junction: Junction, rng: np.random.Generator) -> None:
    """Adds a connector for every turn that a lane allows."""
    number = net.junctions.index(junction)
    for a, arm in enumerate(junction.arms):
        exits = _exits(junction.arms, a)
        for (lane, _), turns in zip(arm.inbound, _allowed_turns(arm, exits, rng), strict=True):
            for turn in turns:
                for exit_arm in exits[turn]:
                    _add_connector(net, junction, number, a, lane, turn, junction.arms[exit_arm])


def _exits(arms: list[Arm], a: int) -> dict[Turn, list[int]]:
    """The arms to which traffic of arm ``a`` can leave, by turn; at most one is straight ahead."""
    heading = arms[a].angle + np.pi
    angles = {b: wrap_to_pi(arm.angle - heading) for b, arm in enumerate(arms) if b != a and arm.outbound}
    exits: dict[Turn, list[int]] = {"left": [], "through": [], "right": []}
    ahead = min(angles, key=lambda b: abs(angles[b]), default=None)
    for b, angle in angles.items():
        if b == ahead and abs(angle) < _MAX_STRAIGHT_ANGLE:
            exits["through"].append(b)
        elif abs(angle) < _MAX_TURN_ANGLE:
            exits["left" if angle > 0 else "right"].append(b)
    return exits


def _allowed_turns(arm: Arm, exits: dict[Turn, list[int]], rng: np.random.Generator) -> list[list[Turn]]:
    """The turns that every inbound lane allows."""
    pockets: list[Turn | None] = [pocket for _, pocket in arm.inbound]
    turns: list[list[Turn]] = [[pocket] if pocket is not None and exits[pocket] else [] for pocket in pockets]
    full_lanes = [k for k, pocket in enumerate(pockets) if pocket is None]
    if not full_lanes:
        return turns
    turns_left = bool(exits["left"]) and "left" not in pockets
    turns_right = bool(exits["right"]) and "right" not in pockets
    if not exits["through"]:
        _share_turns(turns, full_lanes, exits, turns_left and turns_right)
        return turns
    for lane in full_lanes:
        turns[lane].append("through")
    if turns_left:
        if len(full_lanes) > 1 and rng.random() < _LEFT_ONLY_SHARE:
            turns[full_lanes[0]] = ["left"]
        else:
            turns[full_lanes[0]].insert(0, "left")
    if turns_right:
        if len(full_lanes) > 2 and rng.random() < _RIGHT_ONLY_SHARE:
            turns[full_lanes[-1]] = ["right"]
        else:
            turns[full_lanes[-1]].append("right")
    return turns


def _share_turns(
    turns: list[list[Turn]], full_lanes: list[int], exits: dict[Turn, list[int]], turns_both: bool
) -> None:
    """Assigns left and right turns to the lanes of an arm without an exit straight ahead."""
    if turns_both:
        middle = (len(full_lanes) + 1) // 2
        for k, lane in enumerate(full_lanes):
            if k < middle:
                turns[lane].append("left")
            if k >= middle or len(full_lanes) == 1:
                turns[lane].append("right")
        return
    turn: Turn = "left" if exits["left"] else "right"
    for lane in full_lanes if exits[turn] else []:
        turns[lane].append(turn)


def _add_connector(net: Network, junction: Junction, number: int, a: int, lane: int, turn: Turn, exit_arm: Arm) -> None:
    """Connects inner lanes to inner lanes, and right turns to the outermost lane."""
    arm = junction.arms[a]
    candidates = [k for k, pocket in arm.inbound if pocket is None or turn != "through"]
    outbound = exit_arm.outbound
    exit_lane = outbound[-1] if turn == "right" else outbound[min(candidates.index(lane), len(outbound) - 1)]
    before, after = net.lanes[lane], net.lanes[exit_lane]
    if turn == "through":
        speed = min(before.speed, after.speed)
    else:
        speed = _LEFT_TURN_SPEED if turn == "left" else _RIGHT_TURN_SPEED
    connector = net.add_lane(
        Lane(
            turn_curve(before.points, after.points),
            speed,
            before.width,
            before.subtype,
            [exit_lane],
            junction=number,
            turn=turn,
            arm=a,
            entry_lane=lane,
            rank=arm.rank + _TURN_RANK[turn],
            height=before.height,
        )
    )
    net.link(lane, connector)
    junction.connectors.append(connector)
