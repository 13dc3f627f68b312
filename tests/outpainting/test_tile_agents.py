"""Agents of new tiles go with the lanes that bends move."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.data.map_crop import crop_map
from scjax.outpainting.bends import Bends, Joint
from scjax.outpainting.coverage import Coverage, OpenEnd
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.exits import ends_in_window
from scjax.outpainting.tile_agents import move_beside
from scjax.outpainting.tile_candidate import tile_candidate
from scjax.outpainting.window import KnownWindow, WindowPose, cut_window
from scjax.scene import AgentType, Crop, Map, MapTile, permute
from scjax.scene.angles import wrap_to_pi
from tests.factories.maps import map_lane


def _line(y: float, x: float = 0.0, back: bool = False) -> np.ndarray:
    line = np.stack([np.linspace(x, x + 40.0, 41), np.full(41, y), np.zeros(41)], -1)
    return line[::-1] if back else line


def _bends(lines: list[np.ndarray], shift: float, turn: float = 0.0) -> Bends:
    """Bends that move the start of the first line to the left."""
    place = lines[0][0] + np.array([0.0, shift, 0.3])
    return Bends(lines, [], [Joint(0, True, OpenEnd("known", False, place, turn, True))])


def _agents(*rows: tuple[float, float, float]) -> np.ndarray:
    """Agents at x, y with a heading."""
    return np.array([[x, y, 0.0, 5.0, np.cos(yaw), np.sin(yaw), 4.5, 2.0, 1.5] for x, y, yaw in rows])


def _offsets(agent: np.ndarray, line: np.ndarray) -> tuple[float, float]:
    """Distance from a line to the left [m] and heading to it [rad]."""
    steps = np.diff(line[:, :2], axis=0)
    steps /= np.hypot(*steps.T)[:, None]
    away = agent[:2] - line[:-1, :2]
    nearest = np.hypot(*away.T).argmin()
    x, y = steps[nearest]
    return float(x * away[nearest, 1] - y * away[nearest, 0]), float(
        wrap_to_pi(np.arctan2(agent[5], agent[4]) - np.arctan2(y, x))
    )


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_vehicles_keep_their_place_on_the_lane(turn):
    lines = [_line(0.0)]
    bends = _bends(lines, 2.5, turn)
    agents = _agents((1.0, 0.2, 0.1), (6.0, 0.0, 0.0), (12.0, -1.0, 0.0), (39.0, 0.0, 0.0))
    moved = move_beside(agents, np.zeros(4, int), lines, bends)
    (line,) = bends.lines()
    for before, after in zip(agents, moved, strict=True):
        aside, heading = _offsets(after, line)
        assert abs(aside - before[1]) < 0.05, "sideways"
        assert abs(heading - np.arctan2(before[5], before[4])) < 0.05
    assert moved[0, 1] > 1.5 and moved[0, 2] > 0.2 and np.array_equal(moved[3], agents[3])
    assert np.allclose(np.hypot(moved[:, 4], moved[:, 5]), 1.0)


def test_vehicles_go_with_a_lane_of_their_own_direction():
    lines = [_line(0.0), _line(1.5, back=True)]
    moved = move_beside(_agents((2.0, 1.0, 0.0), (2.0, 1.0, np.pi)), np.zeros(2, int), lines, _bends(lines, 2.0))
    assert moved[0, 1] > 2.0 and moved[1, 1] == 1.0


def test_agents_far_from_lanes_stay_and_those_beside_move_along():
    lines = [_line(0.0)]
    agents = _agents((2.0, 3.5, 1.0), (2.0, 7.0, 1.0), (2.0, 11.0, 1.0))
    moved = move_beside(agents, np.full(3, AgentType.PEDESTRIAN, int), lines, _bends(lines, 1.0))
    by = moved[:, 1] - agents[:, 1]
    assert by[0] > 0.7 and 0.0 < by[1] < by[0] and by[2] == 0.0


def test_without_agents_or_lanes_nothing_moves():
    lines = [_line(0.0)]
    assert move_beside(np.zeros((0, 9)), np.zeros(0, int), lines, _bends(lines, 1.0)).shape == (0, 9)


def test_vehicles_of_a_candidate_stand_on_the_lanes_that_meet_the_map():
    """A sample whose new half is 1.5 m beside the known half."""
    known = Map(lanes=(map_lane("a", (-32, 0), (0, 0)),), tiles=(MapTile(x=-32.0, y=0.0, lane_ids=("a",)),))
    pose = WindowPose(0.0, 0.0, 0.0, 0.0)
    scene = cut_window(known, pose)
    car = np.array([[3.0, 1.5, 0.0, 5.0, 1.0, 0.0, 4.5, 2.0, 1.5]])
    whole = Map(
        lanes=(*known.lanes, map_lane("b", (0, 1.5), (32, 1.5))),
        agents=car,
        agent_ids=("car",),
        agent_types=np.zeros(1, np.int32),
        has_topology=True,
    )
    cut = crop_map(whole, 0.0, 0.0, crop=Crop.PARTITIONED)
    order = np.argsort(np.asarray(cut.lanes)[:, :, 0].mean(-1) > 0, kind="stable")
    sample = permute(cut, np.arange(2), order)
    coverage = Coverage(known)
    ends = ends_in_window(coverage.open_ends(known), pose)
    window = KnownWindow(pose, known, scene, ends, DeadTurns(known, ends, 0.0, 0.0))
    candidate = tile_candidate(sample, window, coverage, "1")
    assert candidate.connections == (("a", "1.lane-0"),)
    (lane,), (agent,) = candidate.map.lanes, candidate.map.agents
    assert np.abs(lane.points[0, :2]).max() < 1e-9 and abs(_offsets(agent, lane.points)[0]) < 0.05 and agent[1] < 1.0
