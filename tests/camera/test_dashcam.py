"""Rendered pictures: depth, classes and ids are those of the geometry, and looks depend on their seed alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.camera import preset_rig
from scjax.camera.dashcam import (
    WEATHER,
    DashcamRenderer,
    Look,
    SemanticClass,
    random_look,
    render_dashcam,
    road_surface,
)
from scjax.camera.dashcam.canvas import Canvas
from scjax.camera.dashcam.materials import PAINT_SHARES
from scjax.camera.dashcam.shapes import SHAPES, Shape, shape_of
from scjax.camera.dashcam.surroundings import surrounding_solids
from scjax.camera.dashcam.world_solids import object_colors
from scjax.scene import AgentType, Signal
from tests.factories.camera_logs import CAR, box_log, flat_lane, level_rig
from tests.factories.examples import example_scene
from tests.factories.exports import crossing_log
from tests.factories.logs import example_log

RIG = level_rig(size=(200, 120), focal_length=100.0)  # principal point (100, 60), 1 m above the ground
ROAD = (flat_lane("a", (-50, 0), (120, 0)), flat_lane("b", (120, 3.5), (-50, 3.5)))
WALL = (1.0, 30.0, 8.0)  # m


def frame(log, look=None, *, rig=RIG, step=0, **options):
    return DashcamRenderer(log, rig, look=look, **options).frame(step)


def test_ground_has_exact_depth_and_the_classes_of_the_road():
    picture = frame(box_log((0, 0, 0), lanes=ROAD))
    for row in (65, 80, 119):  # 1 m below the camera
        assert picture.depth[row, 100] == pytest.approx(100 / (row - 60), rel=1e-5)
    beside = {0.0: SemanticClass.ROAD, 2.75: SemanticClass.SIDEWALK, 4.5: SemanticClass.TERRAIN}  # m to the right
    for lateral, expected in beside.items():
        assert picture.classes[80, 100 + round(lateral * 20)] == expected  # 5 m ahead
    sky = picture.classes == SemanticClass.SKY
    assert sky[:20].any() and not sky[70:].any() and np.isinf(picture.depth[sky]).all()
    assert np.isfinite(picture.depth[~sky]).all()


def test_oncoming_lanes_are_parted_by_yellow_and_the_road_is_edged():
    """Markings are 1.75 m beside the lane; five meters ahead these are 35 pixels."""
    picture = frame(box_log((0, 0, 0), lanes=ROAD), supersampling=4)
    row = picture.classes[80]  # 5 m ahead
    marks = np.flatnonzero(row == SemanticClass.MARKING)
    places = sorted({round((100 - column) / 20 / 1.75) for column in marks.tolist()})
    assert places == [-1, 1]
    left = picture.rgb[80, 100 - 35].astype(int)
    assert left[0] > left[2] + 40  # yellow


@pytest.mark.parametrize("supersampling", [1, 2])
@pytest.mark.parametrize("lens", [0.0, -0.15])
def test_depth_is_that_of_planes_behind_any_lens(supersampling, lens):
    """A wall across the way: all its pixels have one depth."""
    log = box_log((0, 0, 0), (10.5, 0, 0), sizes=[CAR, WALL], types=[0, -1])
    picture = frame(log, Look(lens=lens), supersampling=supersampling)
    wall = picture.ids == 1
    assert wall.mean() > 0.5
    np.testing.assert_allclose(picture.depth[wall], 10.0, rtol=1e-5)
    assert (picture.classes[wall] == SemanticClass.OTHER).all()


def test_lens_moves_pixels_as_the_camera_says():
    """The edge of a wall is where the distorted projection puts it."""
    log = box_log((0, 0, 0), (10.5, -15, 0), sizes=[CAR, WALL], types=[0, -1])
    picture = frame(log, Look(lens=-0.3))
    first = np.flatnonzero(picture.ids[60] == 1)
    assert first.min() == 100  # on the axis
    log = box_log((0, 0, 0), (10.5, -21, 0), sizes=[CAR, WALL], types=[0, -1])
    first = np.flatnonzero(frame(log, Look(lens=-0.3)).ids[60] == 1)
    ideal = 6 / 11  # the far edge of the face at its end
    assert first.min() == pytest.approx(100 + 100 * ideal * (1 - 0.3 * ideal**2), abs=1)


def test_nearest_surface_wins_where_boxes_pass_through_each_other():
    """Two walls that cross: each pixel has the smaller of both depths."""
    log = box_log((0, 0, 0), (12, 3, 40), (12, -3, -35), sizes=[CAR, WALL, WALL], types=[0, -1, -1])
    both = frame(log).depth
    alone = []
    for other in (1, 2):
        log.valid[other] = False
        alone.append(frame(log).depth)
        log.valid[other] = True
    np.testing.assert_allclose(both, np.minimum(*alone), rtol=1e-4)


@pytest.mark.parametrize("kind", [*AgentType, -1])
def test_objects_have_class_and_id_and_stay_in_their_box(kind):
    sizes = {AgentType.VEHICLE: CAR, AgentType.STATIC: (0.5, 0.5, 0.9)}
    size = sizes.get(kind, (1.2, 0.9, 1.75))
    log = box_log((0, 0, 0), (8, 0.5, 25), sizes=[CAR, size], types=[0, int(kind)])
    picture = frame(log)
    mine = picture.ids == 1
    expected = SemanticClass[AgentType(kind).name] if kind >= 0 else SemanticClass.OTHER
    assert mine.sum() > 20 and set(picture.classes[mine].tolist()) == {int(expected)}
    reach = np.hypot(size[0], size[1]) / 2 + 0.1
    assert (np.abs(picture.depth[mine] - 8) < reach).all()
    rows, columns = np.nonzero(mine)
    assert columns.min() >= 100 - 100 * (0.5 + reach) / (8 - reach) - 1
    assert rows.min() >= 60 - 100 * (size[2] - 1.0) / (8 - reach) - 2


def test_shapes_follow_class_and_size():
    sizes = np.array([CAR, (9.0, 2.5, 3.0), (5.5, 2.0, 2.4), (0.8, 0.8, 1.7), (2.0, 0.5, 1.0)])
    assert shape_of(np.array([0, 0, 0, 1, 3]), sizes).tolist() == [
        Shape.CAR,
        Shape.LARGE,
        Shape.VAN,
        Shape.PERSON,
        Shape.BARRIER,
    ]
    for parts in SHAPES.values():
        assert np.abs(parts.corners[..., :2]).max() <= 0.52 and -1e-9 <= parts.corners[..., 2].min()
        assert parts.corners[..., 2].max() <= 1.0 and parts.coarse <= len(parts.corners)


def test_carrier_is_not_in_its_picture_and_others_are_seen_from_any_actor():
    log = box_log((0, 0, 0), (15, 0, 180), lanes=ROAD)
    assert set(np.unique(frame(log).ids)) == {-1, 1} and set(np.unique(frame(log, actor=1).ids)) == {-1, 0}


def test_renderer_carried_by_another_object_is_that_objects_own():
    log, look = box_log((0, 0, 0), (15, 0, 180), (8, 3.5, 180), lanes=ROAD), Look(seed=3)
    other, own = DashcamRenderer(log, RIG, look=look).carried_by(1, look).frame(0), frame(log, look, actor=1)
    for part, same in zip(other, own, strict=True):
        assert np.array_equal(part, same)


def test_near_ground_is_the_same_in_the_small_window_ahead_and_in_one_all_around(monkeypatch):
    log = box_log((3, 0, 25), lanes=ROAD)
    narrow = level_rig(size=(200, 120), focal_length=180.0)
    small = frame(log, rig=narrow)
    monkeypatch.setattr(road_surface, "_near_layer", lambda camera: road_surface._NEAR)
    whole = frame(log, rig=narrow)
    assert road_surface._NEAR.ahead == 0 and (small.classes == whole.classes).mean() > 0.999
    assert (np.abs(small.rgb.astype(int) - whole.rgb) <= 1).mean() > 0.999


def test_paints_of_objects_have_their_shares_and_depend_on_id_and_seed_alone():
    names = [f"object-{k}" for k in range(4000)]
    colors = object_colors(names, 5)
    assert np.array_equal(colors[7:9], object_colors(names[7:9], 5))
    assert not np.allclose(colors, object_colors(names, 6))
    hues = colors[:, 0] / np.linalg.norm(colors[:, 0], axis=1, keepdims=True)
    red = (hues[:, 0] > 0.9).mean()  # of all paints one alone
    assert red == pytest.approx(PAINT_SHARES[4], abs=0.02)
    assert colors[:, 1].min() < 0.06 and colors[:, 1].max() > 0.84 and colors[:, 2].max() < 0.4


def test_signals_shine_in_the_color_of_their_state():
    log = crossing_log()
    rig = level_rig(size=(640, 320), focal_length=500.0)
    log.positions[0, :, 0] = -20.0 + np.arange(20)
    look = dataclasses.replace(WEATHER["night"], noise=0.0)
    red, green = (frame(log, look, rig=rig, step=step).rgb.astype(int) for step in (0, 10))
    assert ((red[..., 0] > 200) & (red[..., 1] < 80)).any() and not ((red[..., 1] > 200) & (red[..., 0] < 80)).any()
    assert ((green[..., 1] > 200) & (green[..., 0] < 80)).any()
    assert log.signal_states[0, 0] == Signal.STOP


def test_shadows_darken_the_ground_away_from_the_sun():
    log = box_log((0, 0, 0), (12, 0, 0), lanes=ROAD)
    sun, dark = Look(sun=(90.0, 30.0)), Look(sun=(90.0, 30.0), shadows=0.0)
    with_shadow, without = frame(log, sun).rgb.astype(int), frame(log, dark).rgb.astype(int)
    darker = (without - with_shadow).sum(-1) > 40
    columns = np.nonzero(darker)[1]
    assert darker.sum() > 30 and columns.mean() > 100  # the sun is at the left


def test_surroundings_leave_the_road_free_and_depend_on_place_and_seed():
    log = box_log((0, 0, 0), lanes=ROAD)
    solids = surrounding_solids(log, 3)
    assert {SemanticClass.BUILDING, SemanticClass.VEGETATION} <= set(solids.classes.tolist())
    y = solids.corners[..., 1]
    inside = (solids.corners[..., 0] > -50) & (solids.corners[..., 0] < 120)
    assert not (inside & (y > -1.75) & (y < 5.25)).any()
    same, other = surrounding_solids(log, 3), surrounding_solids(log, 4)
    assert np.array_equal(solids.corners, same.corners)
    assert solids.corners.shape != other.corners.shape or not np.allclose(solids.corners, other.corners)


def test_frames_of_a_sequence_are_those_of_single_steps():
    """Windows of the ground that are kept from step to step change nothing but how their cells are rounded."""
    log = example_log()
    renderer = DashcamRenderer(log, RIG)
    renderer.frame(0)
    late, alone = renderer.frame(9), DashcamRenderer(log, RIG).frame(9)
    assert (late.classes == alone.classes).mean() > 0.99 and np.array_equal(late.depth, alone.depth)
    assert np.array_equal(late.ids, alone.ids)


def test_random_looks_depend_on_the_seed_alone():
    assert random_look(5) == random_look(5) and random_look(5) != random_look(6)
    log = box_log((0, 0, 0), (12, 0, 0), lanes=ROAD)
    assert np.array_equal(frame(log, random_look(5)).rgb, frame(log, random_look(5)).rgb)


@pytest.mark.parametrize("name", WEATHER)
def test_weathers_change_the_picture_but_not_the_geometry(name):
    log = box_log((0, 0, 0), (12, 0, 0), lanes=ROAD)
    clear, other = frame(log), frame(log, WEATHER[name])
    assert np.array_equal(clear.depth, other.depth) and np.array_equal(clear.classes, other.classes)
    if name != "clear":
        assert np.abs(clear.rgb.astype(int) - other.rgb).mean() > 8


def test_mount_of_a_look_moves_the_horizon():
    log = box_log((0, 0, 0))
    level, up = (frame(log, Look(pitch_by=pitch)).depth for pitch in (0.0, 5.0))
    horizons = [np.flatnonzero(np.isfinite(depth[:, 0])).min() for depth in (level, up)]
    assert horizons[1] - horizons[0] == pytest.approx(100 * np.tan(np.deg2rad(5)), abs=1.5)


def test_unknown_weather_lists_the_known_ones():
    with pytest.raises(ValueError, match="no weather 'snow': choose from clear, overcast"):
        random_look(0, "snow")
    with pytest.raises(ValueError, match="supersampling must be"):
        Canvas(RIG.camera(), 9)


def test_scenes_are_rendered_with_every_camera_of_a_rig():
    scene = example_scene(0, agents=6, lanes=8)
    rig = preset_rig("surround-6").fitted(96, 54)
    front = DashcamRenderer(scene, rig, "CAM_FRONT")
    for camera in rig.cameras:
        picture = front.through(camera.name).frame(0)
        assert picture.rgb.shape == (54, 96, 3) and picture.rgb.std() > 5
    [frame] = render_dashcam(scene, "dashcam", size=(224, 224), look=random_look(1))
    assert frame.rgb.shape == (224, 224, 3)
