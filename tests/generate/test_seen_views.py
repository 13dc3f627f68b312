"""Changed views of a picture, and objects that are seen in them."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.camera.photo import as_photo
from scjax.camera.projection import project_points
from scjax.camera.standard_view import standard_camera
from scjax.encoders.dashcam_network import PLACE_SCALE
from scjax.generate.seen_agents import seen_agents
from scjax.generate.seen_views import CHANGES, ViewChange, changed_views, restore_objects, shows_places
from tests.factories.object_tokens import CAR, VEHICLE, tokens

NAMES = ["right", "left", "mirrored", "zoom", "more zoom"]


def dot(x, y):
    """A black standard view with a bright spot where the ground point is seen."""
    camera = standard_camera()
    image = project_points(camera, (np.array([[x, y, 0.0]]) - camera.translation) @ camera.rotation)
    (column, row), pixels = image.pixels[0], np.zeros((224, 224, 3), np.uint8)
    rows, columns = np.indices((224, 224))
    pixels[np.hypot(rows - row, columns - column) < 3] = 255
    return pixels


def ground_place(pixels):
    """Where the ground point of the spot of a view is."""
    camera = standard_camera()
    rows, columns = np.indices(pixels.shape[:2])
    weights = pixels[..., 0].astype(float)
    column, row = (np.average(part, weights=weights) for part in (columns, rows))
    depth = camera.intrinsic[1, 1] * camera.translation[2] / (row - camera.intrinsic[1, 2])
    return camera.translation[0] + depth, -(column - camera.intrinsic[0, 2]) / camera.intrinsic[0, 0] * depth


@pytest.mark.parametrize("index", range(len(CHANGES)), ids=NAMES)
def test_objects_of_a_view_are_put_back_where_the_picture_shows_them(index):
    view = changed_views(as_photo(dot(12.0, 2.0)))[index].pixels
    x, y = ground_place(view)
    point = np.array([[x / PLACE_SCALE, y / PLACE_SCALE, 1.0, 0.0, 0.0, 0.0, 3.0]])  # of no length
    restored = restore_objects(point, CHANGES[index])
    np.testing.assert_allclose(PLACE_SCALE * restored[0, :2], [12.0, 2.0], atol=0.2)
    np.testing.assert_allclose(restored[0, 2:], point[0, 2:])


def test_views_differ_in_content_and_fill_their_size():
    photo = as_photo(np.full((224, 224, 3), 90, np.uint8))
    views = changed_views(photo)
    assert len({photo.content, *(view.content for view in views)}) == len(CHANGES) + 1
    for view in views:
        np.testing.assert_array_equal(view.pixels, photo.pixels)  # no border of another color


def test_a_car_in_an_enlarged_view_is_no_longer():
    """Its rear is twice as far away; its middle is half a length behind that."""
    seen = np.array([[12.2 / PLACE_SCALE, 1.0 / PLACE_SCALE, 1.0, 0.0, 0.4, 0.18, 3.0]])
    restored = restore_objects(seen, ViewChange(zoom=2.0))
    np.testing.assert_allclose(PLACE_SCALE * restored[0, :2], [0.2 + 2 * 10.0 + 2.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(restored[0, 4:6], [0.4, 0.18])


def test_views_share_the_errors_of_the_picture():
    picture = tokens(*[(VEHICLE, 13.0, 3.0, 0.5, 4.5, 1.8)] * 6)
    at_12 = tokens(*[CAR] * 6)
    views = np.stack([_tokens_of_view(change, 6) for change in CHANGES])
    places = [seen_agents(one, views).places for one in (picture, at_12)]
    np.testing.assert_allclose(places[1], [[12.0, 3.0]], atol=1e-3)
    assert 12.05 < places[0][0, 0] < 12.5


def test_what_the_picture_alone_shows_is_no_agent():
    nothing = np.stack([tokens()] * len(CHANGES))
    assert len(seen_agents(tokens(*[CAR] * 4)).types) == 1
    assert not len(seen_agents(tokens(*[CAR] * 4), nothing).types)


@pytest.mark.parametrize(("sees", "agents"), [((0, 1, 2, 3), 1), ((0, 1, 2), 0), ((), 0)])
def test_nearly_all_views_see_an_agent_however_many_cells_it_has(sees, agents):
    views = np.stack([_tokens_of_view(change, 3 if k in sees else 0) for k, change in enumerate(CHANGES)])
    assert len(seen_agents(tokens(*[CAR] * 36), views).types) == agents


def test_views_that_leave_a_place_out_need_not_see_it():
    beside = (VEHICLE, 12.0, 7.0, 0.0, 4.5, 1.8)
    assert [bool(shows_places(change, np.array(beside[1:3]))) for change in CHANGES] == [True, True, True, False, False]
    views = np.stack([_tokens_of_view(change, 3 if k < 3 else 0, beside) for k, change in enumerate(CHANGES)])
    assert len(seen_agents(tokens(*[beside] * 3), views).types) == 1


def _tokens_of_view(change, cells, car=CAR):
    """Tokens of a view of a car."""
    kind, x, y, heading, length, width = car
    forward = np.array([np.cos(heading), np.sin(heading)])
    ahead = x - 0.2
    if change.zoom != 1.0:
        own = forward / [change.zoom, 1.0]
        own = own / np.hypot(*own)
        half = (np.abs(own) * [length, width]).sum() / 2
        ahead, forward = (ahead - half) / change.zoom + half, own
    y = y - change.shift / standard_camera().intrinsic[0, 0] * ahead
    heading = np.arctan2(forward[1], forward[0])
    if change.mirrored:
        y, heading = -y, -heading
    return tokens(*[(kind, 0.2 + ahead, y, heading, length, width)] * cells)
