"""Wireframes: what is where in the picture follows from geometry; depth and ids are exact."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.camera import (
    PALETTES,
    CameraPoses,
    ElementKind,
    WireframeRenderer,
    WireframeStyle,
    overlay,
    render_wireframe,
)
from scjax.scene import AgentType, Signal, scene_to_map
from tests.factories.camera_logs import CAR, box_log, flat_lane, level_rig
from tests.factories.examples import example_scene
from tests.factories.exports import crossing_log
from tests.factories.logs import example_log

RIG = level_rig()  # 200 x 100 pixels, focal length 100, 1 m above the middle of its carrier
PLAIN = WireframeStyle(occlusion=False, borders=False, depth_cue=0.0)
COVERING = WireframeStyle(borders=False, depth_cue=0.0)


def frame(log, *, style=PLAIN, step=0, rig=RIG, **options):
    return WireframeRenderer(log, rig, style=style, **options).frame(step, buffers=True)


def bounds(mask: np.ndarray) -> list[int]:
    """First and last column, first and last row."""
    rows, columns = np.nonzero(mask)
    return [columns.min(), columns.max(), rows.min(), rows.max()]


def spread(mask: np.ndarray, pixels: int = 2) -> np.ndarray:
    """The mask, grown to all sides."""
    for axis in (0, 1):
        mask = np.any([np.roll(mask, shift, axis) for shift in range(-pixels, pixels + 1)], 0)
    return mask


def test_box_is_where_similar_triangles_put_it():
    """Rear face 10 m ahead: 2 m wide and 1.5 m high are 20 and 15 pixels; its bottom is 1 m below the camera."""
    picture = frame(box_log((0, 0, 0), (12, 0, 0)))
    left, right, top, bottom = bounds(picture.kinds == ElementKind.BOX)
    np.testing.assert_allclose([left, right, top, bottom], [90, 110, 45, 60], atol=1)
    assert (picture.rgb[60, 95] > 60).all() and not picture.rgb[60, 120].any()


def test_depth_on_edges_is_that_of_the_box():
    picture = frame(box_log((0, 0, 0), (12, 0, 0)))
    assert picture.depth[60, 100] == pytest.approx(10.0, abs=0.05)  # lower edge of the rear face
    seen = picture.depth[picture.kinds == ElementKind.BOX]
    assert seen.min() == pytest.approx(10.0, abs=1e-3) and seen.max() == pytest.approx(14.0, abs=1e-3)
    assert np.isinf(picture.depth[picture.kinds == ElementKind.NOTHING]).all()


def test_faces_have_exact_depth_where_boxes_cover():
    """A box turned by 45 degrees: depth is that of its two upright faces, column by column."""
    picture = frame(box_log((0, 0, 0), (20, 0, 45), sizes=[CAR, (6.0, 6.0, 3.0)]), style=COVERING)
    corner = 20 - np.sqrt(18)
    for column in (100, 106, 91):
        x = (column - 100) / 100
        assert picture.depth[50, column] == pytest.approx(corner / (1 - abs(x)), rel=0.02)
    assert (picture.ids[50, 92:109] == 1).all()


def test_lane_on_the_ground_has_the_depth_of_its_row():
    log = box_log((0, 0, 0), lanes=[flat_lane("a", (-20, 0), (60, 0))])
    picture = frame(log)
    for row in (55, 60, 80, 95):  # 1 m below the camera: depth is 100 / (row - 50)
        assert picture.depth[row, 100] == pytest.approx(100 / (row - 50), rel=0.03)
        assert picture.ids[row, 100] == 0 and picture.kinds[row, 100] == ElementKind.LANE
    assert not (picture.kinds[:50] == ElementKind.LANE).any()


def test_objects_behind_the_camera_leave_the_picture_black():
    log = box_log((0, 0, 0), (-12, 0, 0), (-3, 4, 30), lanes=[flat_lane("a", (-60, 0), (-1, 0))])
    assert not frame(log).rgb.any() and not frame(log, style=COVERING).rgb.any()


def test_box_around_the_camera_is_drawn_without_it():
    """A carrier is never in its own picture; another box around the camera is, and nothing is infinite or NaN."""
    assert not frame(box_log((0, 0, 0))).rgb.any()
    for style in (PLAIN, COVERING):
        picture = frame(box_log((0, 0, 0), (0.3, 0.1, 10), sizes=[CAR, (6.0, 3.0, 2.5)]), style=style)
        assert picture.rgb.any() and not np.isnan(picture.depth).any()


def test_box_through_the_near_plane_reaches_the_border():
    """A wall beside the camera ends at the border of the picture, not before it."""
    picture = frame(box_log((0, 0, 0), (5, 2, 0), sizes=[CAR, (20.0, 1.0, 2.0)]), style=COVERING)
    assert (picture.ids[40:60, 0] == 1).all() and not (picture.ids[:, 150:] == 1).any()


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-8, 60), st.floats(-8, 8), st.floats(-180, 180)), min_size=1, max_size=5))
def test_buffers_agree_with_the_picture(poses):
    """Wherever a color is, an element is near; depths lie between the planes."""
    log = box_log((0, 0, 0), *poses)
    for style in (PLAIN, COVERING):
        picture = frame(log, style=style)
        bright = (picture.rgb > 100).any(-1)
        bright[:2] = bright[-2:] = bright[:, :2] = bright[:, -2:] = False  # lines beside the picture shine into it
        assert spread(picture.kinds > 0)[bright].all()
        depth = picture.depth[picture.kinds > 0]
        assert (depth >= 0.19).all() and (depth < 90).all()


@pytest.mark.parametrize("size", [(0.0, 0.0, 0.0), (4.0, 0.0, 1.5), (0.0, 2.0, 1.5), (4.0, 2.0, 0.0)])
def test_boxes_without_area_are_lines_or_points(size):
    log = box_log((0, 0, 0), (10, 1, 30), sizes=[CAR, size])
    for style in (PLAIN, COVERING):
        picture = frame(log, style=style)
        assert not np.isnan(picture.depth).any() and (picture.ids == 1).any() == bool((picture.kinds == 5).any())
    assert frame(log).rgb.any()


def test_nearer_box_covers_the_farther_one():
    log = box_log((0, 0, 0), (12, 0, 0), (30, 0, 0))
    open_ids, covered_ids = frame(log).ids, frame(log, style=COVERING).ids
    assert (open_ids == 2).any() and not (covered_ids == 2).any()
    assert (covered_ids == 1).any()
    hidden = frame(log, style=COVERING).rgb[open_ids == 2].max()
    assert hidden < frame(log).rgb[open_ids == 2].max()


def test_visibility_is_symmetric_between_two_actors():
    """Two equal cars face each other across an obstacle: each sees of the other what the other sees of it."""
    log = box_log((0, 0, 0), (30, 1.3, 180), (15, 0.65, 20), sizes=[CAR, CAR, (0.5, 0.6, 0.9)])
    rig = level_rig(size=(400, 200), focal_length=400.0)
    first, second = (frame(log, style=COVERING, rig=rig, actor=actor) for actor in (0, 1))
    assert (first.ids == 1).sum() > 200 and (first.ids == 2).any()
    swapped = np.select([second.ids == 0, second.ids == 1], [1, 0], second.ids)
    assert (first.ids == swapped).mean() > 0.998  # front marks of the obstacle are on one side
    assert np.array_equal(first.kinds, second.kinds) or (first.kinds != second.kinds).mean() < 2e-3
    both = (first.ids == 1) & (swapped == 1)
    np.testing.assert_allclose(first.depth[both], second.depth[both], rtol=1e-4)


def test_frames_do_not_depend_on_where_the_map_is():
    """Coordinates of kilometers change nothing visible."""
    log = box_log((0, 0, 0), (12, 1, 20), lanes=[flat_lane("a", (-20, 0), (60, 0))])
    shift = np.array([331_000.0, -4_690_000.0, 0.0])
    far = dataclasses.replace(
        log,
        positions=log.positions + shift,
        lanes=tuple(dataclasses.replace(lane, points=lane.points + shift) for lane in log.lanes),
    )
    assert np.abs(frame(far).rgb.astype(int) - frame(log).rgb).max() <= 2


def test_sequence_shows_signals_in_all_states():
    log = crossing_log()
    pictures = render_wireframe(log, level_rig(size=(320, 160), focal_length=200.0), style=PLAIN)
    assert pictures.shape == (20, 160, 320, 3)
    red, green = ((pictures == PALETTES["scjax"].signals[s]).all(-1).sum((1, 2)) for s in (Signal.STOP, Signal.GO))
    assert (red[:8] > 0).all() and not red[8:].any() and not green[:8].any() and (green[8:] > 0).all()


def test_stop_lines_and_heads_have_the_id_of_their_signal():
    picture = frame(crossing_log(), step=10, rig=level_rig(size=(640, 320), focal_length=400.0))
    for kind in (ElementKind.STOP_LINE, ElementKind.SIGNAL):
        assert set(picture.ids[picture.kinds == kind].tolist()) == {0}


def test_carrier_that_comes_late_is_drawn_while_it_is_there():
    renderer = WireframeRenderer(crossing_log(), RIG, actor=1)
    assert renderer.steps.tolist() == list(range(5, 20)) and len(list(renderer.frames())) == 15
    with pytest.raises(ValueError, match="from step 5 to 19 only"):
        renderer.frame(0)


def test_unknown_heights_and_sizes_are_filled():
    log = example_log()  # the pedestrian has neither z nor height, one lane has no z
    picture = frame(log, step=5, rig=level_rig(size=(640, 320), focal_length=400.0))
    assert (picture.ids[picture.kinds == ElementKind.BOX] == 2).any()
    bottom = bounds((picture.kinds == ElementKind.BOX) & (picture.ids == 2))[3]
    distance = 5012 - 0.4 - 5005
    assert bottom == pytest.approx(160 + 400 / distance, abs=2)  # it stands on the lane at z = 10


def test_snap_to_ground_lowers_boxes_that_float():
    log = box_log((0, 0, 0), (12, 0, 0), (20, 5, 0), lanes=[flat_lane("a", (-20, 0), (60, 0))])
    log.positions[1, 0, 2] += 0.5
    log.positions[2, 0, 2] += 3.0
    before, after = frame(log), frame(log, style=dataclasses.replace(PLAIN, snap_to_ground=True))
    assert bounds(after.ids == 1)[3] == pytest.approx(60, abs=1) and bounds(before.ids == 1)[3] < 57
    high = (before.kinds == ElementKind.BOX) & (before.ids == 2)
    assert np.array_equal(high, (after.kinds == ElementKind.BOX) & (after.ids == 2))


def test_borders_are_not_between_lanes():
    """Two lanes side by side have one border each, on the outside; a fork has none across its other lane."""
    lanes = [flat_lane("a", (0, 0), (60, 0)), flat_lane("b", (0, 3.5), (60, 3.5))]
    style = dataclasses.replace(PLAIN, borders=True)
    picture = frame(box_log((0, 0, 0), lanes=lanes), style=style, rig=level_rig(size=(400, 200)))
    row = 100 + 10  # 10 m ahead
    columns = np.flatnonzero(picture.kinds[row] == ElementKind.BORDER)
    np.testing.assert_allclose(sorted({columns.min(), columns.max()}), [200 - 52.5, 200 + 17.5], atol=3)
    assert not ((columns > 152) & (columns < 214)).any()


# --- palettes and styles -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PALETTES)
@pytest.mark.parametrize("kind", AgentType)
def test_palettes_color_classes(name, kind):
    log = box_log((0, 0, 0), (12, 0, 0), types=[AgentType.VEHICLE, kind])
    picture = frame(log, style=dataclasses.replace(PLAIN, palette=name))
    color = PALETTES[name].agents[kind]
    assert (picture.rgb == color).all(-1).any()


def test_cosmos_tells_trucks_from_cars():
    log = box_log((0, 0, 0), (20, -3, 0), (20, 3, 0), sizes=[CAR, CAR, (9.0, 2.5, 3.0)])
    picture = frame(log, style=dataclasses.replace(PLAIN, palette="cosmos"))
    assert {tuple(c) for c in picture.rgb[picture.kinds == 5].tolist()} >= {(255, 0, 0), (0, 0, 255)}


def test_depth_cue_darkens_what_is_far():
    near, far = (frame(box_log((0, 0, 0), (x, 0, 0)), style=WireframeStyle(occlusion=False)) for x in (8, 70))
    assert near.rgb.max() > 1.3 * far.rgb.max()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"palette": "neon"}, "palette must be one of scjax, cosmos, sc"),
        ({"depth_cue": 2.0}, "depth_cue must be"),
        ({"near": 0.0}, "near must be"),
        ({"far": 0.1}, "far must be"),
        ({"width": 0}, "width must be"),
    ],
)
def test_style_names_the_field_at_fault(change, message):
    with pytest.raises(ValueError, match=message):
        WireframeStyle(**change)


# --- sources and overlays ----------------------------------------------------------------------------------------


def test_scenes_and_maps_are_drawn_like_logs():
    scene = example_scene(0, agents=6, lanes=8)
    picture = render_wireframe(scene, "dashcam", steps=[0])
    assert picture.shape == (1, 704, 1280, 3) and picture.any()
    map = scene_to_map(scene)
    assert np.array_equal(render_wireframe(map, "dashcam", actor=0), picture)
    with pytest.raises(ValueError, match="no ego to carry the camera"):
        render_wireframe(map)


def test_batch_of_scenes_is_refused():
    scene = example_scene(0)
    batch = scene.replace(**{name: value[None] for name, value in scene.to_dict().items()})
    with pytest.raises(ValueError, match="takes one scene"):
        render_wireframe(batch)


def test_poses_take_the_place_of_the_carrier():
    log = box_log((0, 0, 0), (12, 0, 0))
    poses = CameraPoses(np.eye(3)[None], np.array([[2.0, 0.0, 0.0]]))
    picture = frame(log, poses=poses)
    assert bounds(picture.ids == 1)[3] == pytest.approx(50 + 100 / 8, abs=2)
    with pytest.raises(ValueError, match="give one of each for 1 steps"):
        frame(log, poses=CameraPoses(np.zeros((2, 3, 3)), np.zeros((2, 3))))


@pytest.mark.parametrize(
    ("options", "message"),
    [({"actor": 7}, "actor is 7"), ({"step": 3}, "step is 3"), ({"camera": "rear"}, "has no camera 'rear'")],
)
def test_renderer_names_the_argument_at_fault(options, message):
    with pytest.raises(ValueError, match=message):
        frame(box_log((0, 0, 0)), **options)


def test_overlay_draws_on_the_photograph_only_where_lines_are():
    log = box_log((0, 0, 0), (12, 0, 0))
    photograph = np.full((100, 200, 3), 77, np.uint8)
    picture = overlay(photograph, log, RIG)
    lines = frame(log).kinds == ElementKind.BOX
    assert (picture[~spread(lines)] == 77).all() and (picture[lines] != 77).any(-1).mean() > 0.8


def test_overlay_takes_photographs_of_another_size():
    log = box_log((0, 0, 0), (12, 0, 0))
    assert overlay(np.zeros((50, 100, 3), np.uint8), log, RIG).shape == (50, 100, 3)
    with pytest.raises(
        ValueError, match=r"the camera 'front' takes pictures of 200 x 100 pixels, and this one has 100 x 100"
    ):
        overlay(np.zeros((100, 100, 3), np.uint8), log, RIG)
