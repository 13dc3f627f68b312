"""Vehicles where a picture shows that there is none."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.encoders.dashcam_network import CLASSES, FINE, DashcamConfig
from scjax.generate.seen_space import SeenSpace, move_misplaced
from scjax.scene import AgentType, Crop, empty
from scjax.scene.boxes import overlaps

CAR = (4.6, 1.9, 1.6)
CELLS = 28


def space(depth=60.0):
    """A picture whose cells all show the same."""
    return SeenSpace(np.full((CELLS, CELLS), depth))


def car(x, y):
    return np.array([x, y, 0.8, 0.0, 1.0, 0.0, *CAR])


def scene(*places):
    """The ego and cars on a road that goes on ahead, and beside it out of sight."""
    one = empty(1 + len(places), 2, crop=Crop.FORWARD)
    lanes = np.zeros(one.lanes.shape, np.float32)
    lanes[:, :, 0] = np.linspace(0, 64, lanes.shape[1])
    lanes[1, :, 1] = 30.0
    agents = np.stack([car(0.0, 0.0), *(car(*place) for place in places)]).astype(np.float32)
    return one.replace(
        agents=agents,
        lanes=lanes,
        agent_types=np.full(len(agents), AgentType.VEHICLE, one.agent_types.dtype),
        agent_mask=np.ones(len(agents), bool),
        lane_mask=np.ones(2, bool),
    )


def test_a_car_in_view_of_what_lies_behind_it_is_not_there():
    assert space().shows_empty(car(20.0, 0.0)[None]).all()


@pytest.mark.parametrize(
    ("picture", "place"),
    [
        (space(depth=5.0), (20.0, 0.0)),  # behind something
        (space(), (20.0, 25.0)),  # beside the picture
        (space(), (60.0, 0.0)),  # too far
    ],
)
def test_a_car_may_be_where_the_picture_does_not_say_otherwise(picture, place):
    assert not picture.shows_empty(car(*place)[None]).any()


def test_depth_of_tokens_lies_in_the_place_of_their_fine_cells():
    width = DashcamConfig().width
    cells = np.zeros((width, 2, 3), np.float32)
    of_fine = (width - DashcamConfig().features) // FINE**2
    for fine in range(FINE**2):
        cells[DashcamConfig().features + fine * of_fine + CLASSES] = np.log(10.0 + fine)
    depth = SeenSpace.of_cells(cells).depth
    np.testing.assert_allclose(depth, np.tile([[10.0, 11.0], [12.0, 13.0]], (2, 3)), rtol=1e-5)


def test_a_misplaced_car_goes_to_a_lane_out_of_sight():
    before = scene((20.0, 0.0))
    after = move_misplaced(before, 1, space(), keeps_number=False)
    assert len(after.agents) == 2 and space().hides(after.agents[1].astype(np.float64))
    np.testing.assert_array_equal(after.agents[0], before.agents[0])


def test_a_car_inside_one_that_is_seen_is_moved():
    after = move_misplaced(scene((20.0, 0.0), (21.0, 0.5)), 2, space(depth=5.0), keeps_number=False)
    assert not overlaps(after.agents.astype(np.float64)).any()
    np.testing.assert_allclose(after.agents[1, :2], [20.0, 0.0])


@pytest.mark.parametrize(("keeps_number", "agents"), [(False, 1), (True, 2)])
def test_without_a_place_out_of_sight_numbers_decide(keeps_number, agents):
    one = scene((20.0, 0.0))
    ahead = one.replace(lanes=one.lanes[:, :8][:, np.arange(one.lanes.shape[1]) % 4 + 3] * np.float32([1, 0, 1]))
    assert len(move_misplaced(ahead, 1, space(), keeps_number).agents) == agents
