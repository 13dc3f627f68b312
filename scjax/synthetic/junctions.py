"""Junctions at grade: stop lines, the turns that each lane allows, and the connectors."""

from __future__ import annotations

import numpy as np

from scjax.scene.angles import wrap_to_pi
from scjax.synthetic.curves import STRAIGHT_END, turn_curve
from scjax.synthetic.network import Arm, Junction, Lane, Network, Turn

_MAX_STRAIGHT_ANGLE = np.deg2rad(38.0)
_MAX_TURN_ANGLE = np.deg2rad(150.0)  # larger changes of direction are U-turns
_CORNER_ANGLES = np.deg2rad((15.0, 165.0))  # between neighboring arms that share a corner
_RIGHT_TURN_SPEED, _LEFT_TURN_SPEED = 6.0, 7.5  # m/s
_MIN_STOP_DISTANCE, MAX_STOP_DISTANCE = 5.0, 22.0  # m; from further lines no turn is in sight
_MIN_CORNER_ROOM = 2.5  # m between a corner and the stop lines
_TURN_RANK = {"through": 0, "right": 1, "left": 2}
_LEFT_ONLY_SHARE, _RIGHT_ONLY_SHARE = 0.4, 0.2  # of junctions with lanes for one turn only
_FAN_SHARE = 0.35  # of the arms whose turns end in any lane of an exit
_MAX_FAN = 3  # lanes


class InfeasiblePlan(Exception):
    """The roads of a plan are too close to each other or too wide, or do not connect."""


def stop_distances(angles: list[float], arriving: list[float], leaving: list[float], radii: list[float]) -> list[float]:
    """Distances of the stop lines from the center, so that neighboring roads do not overlap [m].

    Args:
      angles: directions of the arms, ascending [rad].
      arriving, leaving: half widths of each arm on the side of the lanes that arrive and that leave [m].
      radii: of the curb at the corners of each arm [m].

    Raises:
      InfeasiblePlan: if a stop line would lie further than ``MAX_STOP_DISTANCE`` from the center.
    """
    distances = [_MIN_STOP_DISTANCE] * len(angles)
    for i in range(len(angles)):
        j = (i + 1) % len(angles)
        gap = (angles[j] - angles[i]) % (2 * np.pi)
        if not _CORNER_ANGLES[0] < gap < _CORNER_ANGLES[1]:
            continue
        sin, cos = np.sin(gap), np.cos(gap)
        # From the corner, where the edges of the roads meet, to the ends of the arc between them.
        room = max(radii[i], radii[j]) * np.tan((np.pi - gap) / 2) + STRAIGHT_END
        distances[i] = max(distances[i], (leaving[j] + arriving[i] * cos) / sin + max(room, _MIN_CORNER_ROOM))
        distances[j] = max(distances[j], (arriving[i] + leaving[j] * cos) / sin + max(room, _MIN_CORNER_ROOM))
    if max(distances) > MAX_STOP_DISTANCE:
        raise InfeasiblePlan("the roads of a junction are too wide: give them fewer lanes or a larger angle")
    return [float(distance) for distance in distances]


def add_connectors(net: Network, junction: Junction, rng: np.random.Generator) -> None:
    """Adds a connector for every turn that a lane allows, so that every lane that leaves has one.

    Raises:
      InfeasiblePlan: if an arm cannot be left or reached.
    """
    number = net.junctions.index(junction)
    angles, has_exit = [arm.angle for arm in junction.arms], [bool(arm.outbound) for arm in junction.arms]
    for a, arm in enumerate(junction.arms):
        exits = exits_by_turn(angles, has_exit, a)
        if arm.inbound and not any(exits.values()):
            raise InfeasiblePlan("an arm of a junction has no exit: turn a one-way road around")
        turns_of_lanes = _allowed_turns(arm, exits, rng)
        fans_out = rng.random() < _FAN_SHARE
        for (lane, _), turns in zip(arm.inbound, turns_of_lanes, strict=True):
            for turn in turns:
                is_alone = sum(turn in others for others in turns_of_lanes) == 1
                for exit_arm in exits[turn]:
                    fan = _MAX_FAN if fans_out and is_alone and turn != "through" else 1
                    _add_connectors_to(net, junction, number, a, lane, turn, junction.arms[exit_arm], fan)
    for arm in junction.arms:
        _fill_exit(net, junction, number, arm)


def exits_by_turn(angles: list[float], has_exit: list[bool], a: int) -> dict[Turn, list[int]]:
    """The arms to which traffic of arm ``a`` can leave, by turn; at most one is straight ahead.

    Args:
      angles: directions of the arms, seen from the junction [rad].
      has_exit: whether lanes leave through the arm.
    """
    heading = angles[a] + np.pi
    turns = {b: wrap_to_pi(angles[b] - heading) for b in range(len(angles)) if b != a and has_exit[b]}
    exits: dict[Turn, list[int]] = {"left": [], "through": [], "right": []}
    ahead = min(turns, key=lambda b: abs(turns[b]), default=None)
    for b, angle in turns.items():
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


def _add_connectors_to(
    net: Network, junction: Junction, number: int, a: int, lane: int, turn: Turn, exit_arm: Arm, fan: int
) -> None:
    """Connects inner lanes to inner lanes, right turns to the outermost lane, and turns to ``fan`` lanes in all."""
    arm = junction.arms[a]
    candidates = [k for k, pocket in arm.inbound if pocket is None or turn != "through"]
    outbound = exit_arm.outbound
    first = len(outbound) - 1 if turn == "right" else min(candidates.index(lane), len(outbound) - 1)
    last = max(first - fan, -1) if turn == "right" else min(first + fan, len(outbound))
    for k in range(first, last, 1 if last > first else -1):
        _connect_lanes(net, junction, number, a, lane, turn, outbound[k])


def _fill_exit(net: Network, junction: Junction, number: int, arm: Arm) -> None:
    """Adds connectors to the lanes of an exit that none leads to, beside those to their neighbors."""
    exits = {k: net.lanes[k].successors[0] for k in junction.connectors}
    connectors = [k for k in junction.connectors if exits[k] in arm.outbound]
    if arm.outbound and not connectors:
        raise InfeasiblePlan("an arm of a junction cannot be reached: turn a one-way road around")
    for position, exit_lane in enumerate(arm.outbound):
        if exit_lane in exits.values():
            continue

        def distance(connector: int, position: int = position) -> tuple[int, int]:
            return abs(arm.outbound.index(exits[connector]) - position), net.lanes[connector].rank

        neighbor = net.lanes[min(connectors, key=distance)]
        assert neighbor.turn is not None
        _connect_lanes(net, junction, number, neighbor.arm, neighbor.entry_lane, neighbor.turn, exit_lane)


def _connect_lanes(
    net: Network, junction: Junction, number: int, a: int, lane: int, turn: Turn, exit_lane: int
) -> None:
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
            rank=junction.arms[a].rank + _TURN_RANK[turn],
            height=before.height,
        )
    )
    net.link(lane, connector)
    junction.connectors.append(connector)
