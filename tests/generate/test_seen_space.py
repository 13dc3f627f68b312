"""Vehicles where a picture shows that there is none."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.camera.dashcam.materials import SemanticClass
from scjax.encoders.dashcam_network import CLASSES, FINE, DashcamConfig
from scjax.generate.seen_picture import SeenPicture
from scjax.generate.seen_space import SeenSpace, move_misplaced
from scjax.scene import AgentType, Crop, empty
from scjax.scene.boxes import overlaps
from tests.factories.object_tokens import tokens

CAR = (4.6, 1.9, 1.6)
CELLS = 28


def space(depth=60.0, ground=0.0):
    """A picture whose cells all show the same."""
    return SeenSpace(np.full((CELLS, CELLS), depth), np.full((CELLS, CELLS), ground))


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


def test_a_car_in_a_gap_between_cars_would_be_seen():
    """A gap is narrower than a cell of the picture, and cells show the nearer thing."""
    picture = space(depth=5.0)
    assert not picture.shows_empty(car(20.0, 0.0)[None]).any()
    picture.depth[:, CELLS // 2 - 1 : CELLS // 2 + 1] = 60.0
    seen = SeenSpace(picture.depth, picture.ground)
    assert seen.shows_empty(car(20.0, 0.0)[None]).all() and seen.shows_empty(car(20.0, 2.0)[None]).all()
    assert not seen.shows_empty(car(20.0, 5.0)[None]).any()


def test_depth_of_tokens_lies_in_the_place_of_their_fine_cells():
    width = DashcamConfig().width
    cells = np.zeros((width, 2, 3), np.float32)
    of_fine = (width - DashcamConfig().features) // FINE**2
    for fine in range(FINE**2):
        cells[DashcamConfig().features + fine * of_fine + CLASSES] = np.log(10.0 + fine)
    cells[DashcamConfig().features + of_fine + SemanticClass.ROAD] = 20.0  # of the second fine cell
    cells[DashcamConfig().features + 2 * of_fine + SemanticClass.VEHICLE] = 20.0
    seen = SeenSpace.of_cells(cells)
    np.testing.assert_allclose(seen.depth, np.tile([[10.0, 11.0], [12.0, 13.0]], (2, 3)), rtol=1e-5)
    np.testing.assert_allclose(seen.ground, np.tile([[4 / CLASSES, 1.0], [0.0, 4 / CLASSES]], (2, 3)), atol=1e-4)


def test_a_car_hides_the_ground_behind_its_lower_half():
    at_20_m = car(20.0, 0.0)[None]
    assert space(ground=1.0).shows_ground(at_20_m).all()
    assert not space(ground=0.8).shows_ground(at_20_m).any()  # some cells show other things, as behind an object
    assert not space(ground=1.0).shows_ground(car(20.0, 25.0)[None]).any()  # beside the picture


@pytest.mark.parametrize(("semantic_class", "agents"), [(SemanticClass.ROAD, 1), (SemanticClass.BUILDING, 2)])
def test_seen_cars_stand_where_no_ground_is_seen(semantic_class, agents):
    """A person may stand on cells of ground: these are too coarse for legs."""
    objects = [(SemanticClass.VEHICLE, 20.0, 0.0, 0.0, 4.6, 1.9)] * 3
    people = [(SemanticClass.PEDESTRIAN, 20.0, 6.0, 0.0, 0.6, 0.6)] * 3
    cells = tokens(*objects, *people, cells=CELLS**2 // FINE**2)[:, 5:]
    fine = cells.reshape(len(cells), FINE**2, -1)
    fine[2:, :, semantic_class] = 30.0
    cells = np.concatenate([np.zeros((len(cells), DashcamConfig().features), np.float32), cells], 1)
    picture = SeenPicture(cells.T.reshape(-1, CELLS // FINE, CELLS // FINE))
    assert len(picture.agents.types) == agents and AgentType.PEDESTRIAN in picture.agents.types


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
