"""Scenes drawn by hand that each show one road layout, with the facts that they must give."""

from __future__ import annotations

import numpy as np

from scjax.scene import Signal
from tests.factories.hand_drawn_scene import WIDTH, SceneBuilder


def straight_road(same=1, opposite=1, **kwargs):
    builder = SceneBuilder()
    builder.add_road(same, opposite, **kwargs)
    return builder


def intersection(x, y, arms, lanes=1, **kwargs):
    """An intersection at (x, y) [m]; the ego drives on its western arm where that exists and y is 0."""
    return SceneBuilder().add_intersection((x, y + WIDTH / 2), arms, lanes, **kwargs)


def t_with_askew_lane():
    """A T-intersection with one connector that ends askew, as a model may draw it."""
    builder = intersection(12, 0, (0, 180, -90), lanes=2)
    connector = builder.lanes[14]
    connector[-2:, :2] = connector[-3, :2] + np.array([[0.9], [1.8]]) * np.array([np.cos(-0.9), np.sin(-0.9)])
    return builder


def curved_road(degrees):
    """An arc of 64 m with a total turn of ``degrees``, positive to the left."""
    builder, turn = SceneBuilder(), np.deg2rad(degrees) * np.linspace(-1, 1, 41) / 2
    radius = 32 / np.deg2rad(degrees) * 2
    for side, flip in ((0.0, 1), (WIDTH, -1)):
        line = np.stack([(radius - side) * np.sin(turn), radius - (radius - side) * np.cos(turn)], -1)
        builder.add_lane(*line[::flip])
    return builder


def winding_road():
    builder, x = SceneBuilder(), np.linspace(-32, 32, 60)
    y = 4 * np.sin(x / 9)
    builder.add_lane(*np.stack([x, y - 0.0], -1))
    builder.add_lane(*np.stack([x, y + 4], -1)[::-1])
    return builder


def roundabout():
    builder = SceneBuilder(speed=6.0)
    angle = np.deg2rad(np.linspace(0, 90, 20))
    center, radius = np.array([0.0, 15.0]), 15.0
    arcs = []
    for k in range(4):
        turn = angle + k * np.pi / 2 - np.pi / 2
        arcs.append(builder.add_lane(*(center + radius * np.stack([np.cos(turn), np.sin(turn)], -1))))
    builder.link(*[(arcs[k], arcs[(k + 1) % 4]) for k in range(4)])
    for k, arm in enumerate((0, 90, 180, -90)):
        out = np.array([np.cos(np.deg2rad(arm)), np.sin(np.deg2rad(arm))])
        leave = builder.add_lane(builder.lanes[arcs[k]][-1, :2], center + 40 * out)
        enter = builder.add_lane(center + 40 * out + [1, 1], builder.lanes[arcs[k]][-1, :2])
        builder.link((arcs[k], leave), (enter, arcs[(k + 1) % 4]))
    return builder


def fork(angle, at=0.0, merge=False, reach=30.0):
    """A road with one lane that forks at x = ``at`` [m] by ``angle`` [rad], or merges there."""
    builder = SceneBuilder()
    sign = -1 if merge else 1
    main = builder.add_lane(*[(-32, 0), (at, 0)][::sign] if not merge else [(at, 0), (32, 0)])
    ends = [(at + sign * 32, 0), (at + sign * reach * np.cos(angle), reach * np.sin(angle))]
    for end in ends:
        line = [(at, 0), end]
        branch = builder.add_lane(*line[::sign])
        builder.link((branch, main) if merge else (main, branch))
    return builder


def side_streets():
    builder = SceneBuilder()
    for x in (-24, 0, 24):
        builder.add_intersection((x, WIDTH / 2), (0, 180, -90), size=4, reach=12)
    return builder


def bridge():
    builder = straight_road(1, 1)
    builder.add_lane((10, -32), (10, 32), z=7.0)
    builder.add_lane((14, 32), (14, -32), z=7.0)
    return builder


def turn_lane(turn):
    """An approach with two lanes; the ego is in the outer one, which allows ``turn`` only."""
    builder = SceneBuilder()
    side = 1 if turn == "left" else -1
    through_approach = builder.add_lane((-32, -side * WIDTH), (8, -side * WIDTH))
    turn_approach = builder.add_lane((-32, 0), (8, 0))
    through_exit = builder.add_lane((28, -side * WIDTH), (32, -side * WIDTH))
    through = builder.add_lane((8, -side * WIDTH), (28, -side * WIDTH))
    turn_exit = builder.add_lane((18, side * 10), (18, side * 32))
    connector = builder.add_connector((8, 0), 0, (18, side * 10), side * 90)
    builder.add_lane((14, 32), (14, -32)) if turn == "left" else builder.add_lane((14, -32), (14, 32))
    builder.link((through_approach, through), (through, through_exit))
    builder.link((turn_approach, connector), (connector, turn_exit))
    other_turn = builder.add_connector((8, -side * WIDTH), 0, (22, -side * 12), -side * 90)
    builder.link((through_approach, other_turn), (other_turn, builder.add_lane((22, -side * 12), (22, -side * 32))))
    return builder


def intersection_with_signal(state):
    builder = intersection(20, 0, (0, 90, 180, -90))
    for k, line in enumerate(builder.lanes):
        if abs(line[0, 1]) < 1 and line[0, 0] < 11 and line[-1, 0] > 9:
            builder.signals[k] = state
    return builder


ROAD_SCENES = {
    "two lanes, two ways": (
        straight_road(),
        {"layout": "straight", "lanes_same": 1, "lanes_opposite": 1, "median": False},
    ),
    "one way": (
        straight_road(3, 0, ego_index=2),
        {"layout": "straight", "lanes_same": 3, "lanes_opposite": 0, "lane_index": 2},
    ),
    "single lane": (straight_road(1, 0), {"layout": "straight", "lanes_same": 1, "lanes_opposite": 0}),
    "four lanes": (straight_road(2, 2), {"layout": "straight", "lanes_same": 2, "lanes_opposite": 2, "lane_index": 1}),
    "right lane": (straight_road(2, 2, ego_index=2), {"lanes_same": 2, "lanes_opposite": 2, "lane_index": 2}),
    "median": (straight_road(2, 2, gap=5.0), {"median": True, "lanes_same": 2, "lanes_opposite": 2}),
    "uneven": (straight_road(3, 2, ego_index=3), {"lanes_same": 3, "lanes_opposite": 2, "lane_index": 3}),
    "left curve": (curved_road(30), {"layout": "curve", "curve": "left"}),
    "right curve": (curved_road(-30), {"layout": "curve", "curve": "right"}),
    "gentle curve": (curved_road(14), {"layout": "straight", "curve": "gently left"}),
    "winding": (winding_road(), {"layout": "winding", "curve": "winding"}),
    "crossroads ahead": (
        intersection(20, 0, (0, 90, 180, -90)),
        {"layout": "four-way", "intersection_side": "ahead", "intersection_distance": 20},
    ),
    "inside a crossroads": (
        intersection(0, 0, (0, 90, 180, -90)),
        {"layout": "four-way", "intersection_side": "inside"},
    ),
    "crossroads behind": (
        intersection(-20, 0, (0, 90, 180, -90)),
        {"layout": "four-way", "intersection_side": "behind"},
    ),
    "wide crossroads": (
        intersection(20, 0, (0, 90, 180, -90), lanes=2, size=14),
        {"layout": "four-way", "lanes_same": 2, "lanes_opposite": 2},
    ),
    "skewed crossroads": (intersection(18, 0, (0, 60, 180, -120)), {"layout": "four-way"}),
    "T to the right": (
        intersection(18, 0, (0, 180, -90)),
        {"layout": "T", "side_streets_right": 1, "side_streets_left": 0},
    ),
    "T to the left": (intersection(18, 0, (0, 180, 90)), {"layout": "T", "side_streets_left": 1}),
    "T at the end of the road": (
        intersection(18, 0, (90, 180, -90)),
        {"layout": "T", "ego_options": ("left", "right")},
    ),
    "T with a lane end askew": (t_with_askew_lane(), {"layout": "T", "intersection": "T"}),
    "five arms": (intersection(10, 0, (0, 70, 120, 180, -90)), {"layout": "complex", "intersection": "complex"}),
    "side streets": (side_streets(), {"layout": "several side streets", "side_streets_right": 3}),
    "roundabout": (roundabout(), {"layout": "roundabout"}),
    "lane added": (fork(0.12, at=5.0), {"layout": "lane added"}),
    "lane ends": (fork(0.12, at=-5.0, merge=True), {"layout": "lane ends"}),
    "split": (fork(0.5, at=5.0), {"layout": "split"}),
    "merge": (fork(0.5, at=-5.0, merge=True), {"layout": "merge"}),
    "left-turn lane": (turn_lane("left"), {"turn_lanes": ("left",), "ego_turn_lane": "left"}),
    "right-turn lane": (turn_lane("right"), {"turn_lanes": ("right",), "ego_turn_lane": "right"}),
    "bridge": (bridge(), {"layout": "straight", "bridge": True, "intersection": None}),
    "green light": (intersection_with_signal(Signal.GO), {"layout": "four-way", "signals": "green"}),
    "red light": (intersection_with_signal(Signal.STOP), {"signals": "red"}),
    "no road": (SceneBuilder(), {"layout": "no road", "curve": None, "lanes_same": 0}),
}
