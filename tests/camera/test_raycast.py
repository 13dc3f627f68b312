"""The stand-in for an image: what geometry says of depths, shares and occlusion; nothing hidden."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.camera.raycast import CLASSES, EYE, FAR, GRID, GROUND, LANE, NOTHING, RAYS, View, look, stand_in
from scjax.camera.raycast import _rays as rays
from scjax.scene import AgentType, Crop, Scene, empty, pad, permute
from scjax.viz import camera_view_grid
from tests.factories.examples import example_scene

VEHICLE, PEDESTRIAN = int(AgentType.VEHICLE), int(AgentType.PEDESTRIAN)


def world(*boxes, lanes=()) -> Scene:
    """An ego, and boxes (x, y, heading in degrees, length, width, height, type) on flat ground."""
    scene = empty(1 + len(boxes), len(lanes), crop=Crop.FORWARD)
    for k, (x, y, degrees, length, width, height, kind) in enumerate([(0, 0, 0, 4.5, 2, 1.6, VEHICLE), *boxes]):
        turn = np.deg2rad(degrees)
        scene.agents[k] = [x, y, height / 2, 0, np.cos(turn), np.sin(turn), length, width, height]
        scene.agent_types[k] = kind
    for k, (start, end) in enumerate(lanes):
        scene.lanes[k, :, :2] = np.linspace(start, end, 20)
    scene.agent_mask[:], scene.lane_mask[:] = True, True
    return scene


def same(first: Scene, second: Scene) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(look(first), look(second), strict=True))


def wall(x: float) -> Scene:
    """Its near face at x, wider and taller than the picture."""
    return world((x + 0.5, 0, 0, 1, 200, 60, VEHICLE))


def test_an_empty_world_is_ground_below_the_horizon_and_nothing_above():
    _, drop, _, inside = rays()
    view = look(world())
    assert (view.kind[inside] == GROUND).all() and (view.kind[~inside] == NOTHING).all()
    assert (view.kind[drop <= 0] == NOTHING).all() and (view.depth[~inside] == FAR).all()
    depth = np.broadcast_to((EYE / np.where(drop > 0, drop, 1))[:, None], inside.shape)
    np.testing.assert_allclose(view.depth[inside], depth[inside], rtol=1e-6)


@pytest.mark.parametrize("x", [10.0, 17.0])
def test_a_wall_has_its_depth_in_its_cells(x):
    features = stand_in(wall(x))
    _, drop, _, _ = rays()
    rows = (drop.reshape(GRID[0], RAYS[0]) * x < EYE).all(1)  # cells above where it stands
    assert 3 < rows.sum() < GRID[0]
    np.testing.assert_allclose(features.depth[rows] * FAR, x, rtol=1e-6)
    assert (features.image[VEHICLE, rows] == 1).all()
    below = (drop.reshape(GRID[0], RAYS[0]) * x > EYE).all(1)
    assert (features.image[GROUND, below] == 1).all() and (features.depth[below] * FAR < x).all()


def test_shares_add_up_and_depths_are_finite():
    for seed in range(5):
        features = stand_in(example_scene(seed, agents=12, lanes=9, crop=Crop.FORWARD))
        assert features.image.shape == (len(CLASSES), *GRID) and features.depth.shape == GRID
        np.testing.assert_allclose(features.image.sum(0), 1, atol=1e-6)
        assert (features.depth > 0).all() and (features.depth <= 1).all()


def test_an_occluded_agent_adds_nothing():
    truck, person = (12, 0, 90, 8, 2.5, 3.5, VEHICLE), (20, 0.3, 0, 0.6, 0.6, 1.8, PEDESTRIAN)
    assert same(world(truck), world(truck, person))
    alone = stand_in(world(person))
    assert alone.image[PEDESTRIAN].sum() > 0
    behind = (-12, 0, 90, 8, 2.5, 3.5, VEHICLE)
    aside = (3, 25, 0, 4, 2, 1.5, VEHICLE)  # outside the field of view
    assert same(world(), world(behind, aside))


def test_what_moves_away_is_deeper_and_smaller():
    """A face at x covers slopes up to (height - EYE) / x over the horizon and its width over x across."""
    lateral, drop, _, _ = rays()
    for x in (8.0, 12.0, 24.0):
        view = look(world((x + 2, 1, 0, 4, 2, 2.5, VEHICLE)))
        face = (view.kind == VEHICLE) & np.isclose(view.depth, x)
        columns = (lateral * x > 0) & (lateral * x < 2)
        rows = (drop * x < EYE) & (EYE - drop * x < 2.5)
        np.testing.assert_array_equal(face, rows[:, None] & columns)


def test_the_top_of_a_low_box_is_seen_from_above():
    view, (_, drop, _, _) = look(world((6, 0, 0, 4, 4, 0.5, int(AgentType.STATIC)))), rays()
    row = np.argmin(np.abs(drop - (EYE - 0.5) / 6))  # meets the top about its middle
    middle = view.depth.shape[1] // 2
    assert view.kind[row, middle] == AgentType.STATIC
    np.testing.assert_allclose(view.depth[row, middle], (EYE - 0.5) / drop[row], rtol=1e-5)


def inside_something(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Whether points [n, 3] lie in a box that stands on the ground, or below the ground."""
    found = points[:, 2] < 0
    for x, y, _, _, cos, sin, length, width, height in np.asarray(scene.agents, np.float64)[1:]:
        dx, dy = points[:, 0] - x, points[:, 1] - y
        along, across = dx * cos + dy * sin, dy * cos - dx * sin
        found |= (np.abs(along) < length / 2) & (np.abs(across) < width / 2) & (points[:, 2] < height)
    return found


@pytest.mark.parametrize("seed", range(4))
def test_rays_end_where_they_first_meet_something(seed):
    rng = np.random.default_rng(seed)
    boxes = [
        (*rng.uniform([3, -20], [50, 20]), rng.uniform(0, 360), *rng.uniform(0.5, [8, 3, 3.5]), int(rng.integers(4)))
        for _ in range(12)
    ]
    scene = world(*boxes)
    view, (lateral, drop, _, inside) = look(scene), rays()
    for _ in range(300):
        i, j = rng.integers(len(drop)), rng.integers(len(lateral))
        at = np.concatenate([np.arange(0.02, view.depth[i, j] - 1e-3, 0.02), [view.depth[i, j] + 1e-3]])
        points = np.stack([at, lateral[j] * at, EYE - drop[i] * at], 1)
        found = inside_something(scene, points)
        if view.kind[i, j] != NOTHING:
            assert found[-1]
        if view.kind[i, j] != NOTHING or inside[i, j]:
            assert not found[:-1].any()


def test_left_is_left():
    left, right = (look(world((15, y, 0, 4, 2, 1.6, VEHICLE))) for y in (6, -6))
    assert isinstance(left, View)
    np.testing.assert_array_equal(left.kind, right.kind[:, ::-1])
    columns = np.flatnonzero((left.kind == VEHICLE).any(0))
    assert columns.max() < left.kind.shape[1] // 2


def test_lanes_are_ribbons_on_the_ground():
    view = look(world(lanes=[((0, 0), (64, 0))]))
    lateral, drop, _, inside = rays()
    aside = np.abs(lateral[None] * EYE / np.where(drop > 0, drop, np.inf)[:, None])
    assert (view.kind[inside & (aside < 1.5)] == LANE).all()
    assert (view.kind[inside & (aside > 2.3)] == GROUND).all()


def test_padding_order_and_the_ego_are_not_seen():
    scene = example_scene(3, agents=9, lanes=6, padding=0, crop=Crop.FORWARD)
    assert same(scene, pad(scene, 20, 30))
    rng = np.random.default_rng(0)
    assert same(scene, permute(scene, np.concatenate([[0], 1 + rng.permutation(8)]), rng.permutation(6)))
    big = scene.replace(agents=np.concatenate([[[5, 0, 1, 0, 1, 0, 4, 30, 4]], scene.agents[1:]]).astype(np.float32))
    assert same(scene, big)


def test_what_is_no_single_scene_ahead_is_refused():
    with pytest.raises(ValueError, match="a CENTRED scene: crop it ahead"):
        stand_in(example_scene())
    scene = world()
    with pytest.raises(ValueError, match=r"a batch \(1,\)"):
        look(scene.replace(**{name: value[None] for name, value in scene.to_dict().items()}))


def test_a_picture_shows_them_beside_their_scenes(tmp_path):
    figure = camera_view_grid([wall(10.0), world()], path=tmp_path / "ahead.png")
    assert len(figure.axes) == 8 and (tmp_path / "ahead.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="no scenes"):
        camera_view_grid([])
