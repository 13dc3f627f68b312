"""Ray-casting: depths, class shares and occlusion follow from geometry."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.camera.raycast import (
    CAMERA_HEIGHT,
    CLASSES,
    GRID,
    GROUND,
    LANE,
    MAX_DEPTH,
    NOTHING,
    RAYS_PER_CELL,
    RayHits,
    cast_rays,
    ray_grid,
    render,
)
from scjax.scene import AgentType, Crop, Scene, empty, pad, permute
from scjax.viz import camera_view_grid
from tests.factories.examples import example_scene

VEHICLE, PEDESTRIAN = int(AgentType.VEHICLE), int(AgentType.PEDESTRIAN)


def world(*boxes, lanes=()) -> Scene:
    """An ego, and boxes (x, y, heading in degrees, length, width, height, type) on flat ground."""
    scene = empty(1 + len(boxes), len(lanes), crop=Crop.FORWARD)
    for k, (x, y, degrees, length, width, height, agent_type) in enumerate([(0, 0, 0, 4.5, 2, 1.6, VEHICLE), *boxes]):
        turn = np.deg2rad(degrees)
        scene.agents[k] = [x, y, height / 2, 0, np.cos(turn), np.sin(turn), length, width, height]
        scene.agent_types[k] = agent_type
    for k, (start, end) in enumerate(lanes):
        scene.lanes[k, :, :2] = np.linspace(start, end, 20)
    scene.agent_mask[:], scene.lane_mask[:] = True, True
    return scene


def same(first: Scene, second: Scene) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(cast_rays(first), cast_rays(second), strict=True))


def wall(x: float) -> Scene:
    """Its near face at x, wider and taller than the picture."""
    return world((x + 0.5, 0, 0, 1, 200, 60, VEHICLE))


def test_cast_rays_empty_world_is_ground_and_nothing():
    _, drop, _, on_map = ray_grid()
    hits = cast_rays(world())
    assert (hits.classes[on_map] == GROUND).all() and (hits.classes[~on_map] == NOTHING).all()
    assert (hits.classes[drop <= 0] == NOTHING).all() and (hits.depth[~on_map] == MAX_DEPTH).all()
    depth = np.broadcast_to((CAMERA_HEIGHT / np.where(drop > 0, drop, 1))[:, None], on_map.shape)
    np.testing.assert_allclose(hits.depth[on_map], depth[on_map], rtol=1e-6)


@pytest.mark.parametrize("x", [10.0, 17.0])
def test_render_wall_has_its_depth(x):
    features = render(wall(x))
    drop = ray_grid().drop
    rows = (drop.reshape(GRID[0], RAYS_PER_CELL[0]) * x < CAMERA_HEIGHT).all(1)  # cells above where it stands
    assert 3 < rows.sum() < GRID[0]
    np.testing.assert_allclose(features.depth[rows] * MAX_DEPTH, x, rtol=1e-6)
    assert (features.image[VEHICLE, rows] == 1).all()
    below = (drop.reshape(GRID[0], RAYS_PER_CELL[0]) * x > CAMERA_HEIGHT).all(1)
    assert (features.image[GROUND, below] == 1).all() and (features.depth[below] * MAX_DEPTH < x).all()


def test_render_shares_sum_to_one_and_depths_are_finite():
    for seed in range(5):
        features = render(example_scene(seed, agents=12, lanes=9, crop=Crop.FORWARD))
        assert features.image.shape == (len(CLASSES), *GRID) and features.depth.shape == GRID
        np.testing.assert_allclose(features.image.sum(0), 1, atol=1e-6)
        assert (features.depth > 0).all() and (features.depth <= 1).all()


def test_cast_rays_occluded_agent_is_invisible():
    truck, person = (12, 0, 90, 8, 2.5, 3.5, VEHICLE), (20, 0.3, 0, 0.6, 0.6, 1.8, PEDESTRIAN)
    assert same(world(truck), world(truck, person))
    alone = render(world(person))
    assert alone.image[PEDESTRIAN].sum() > 0
    behind = (-12, 0, 90, 8, 2.5, 3.5, VEHICLE)
    aside = (3, 25, 0, 4, 2, 1.5, VEHICLE)  # outside the field of view
    assert same(world(), world(behind, aside))


def test_cast_rays_face_covers_its_slopes():
    """A face at x covers slopes up to (height - CAMERA_HEIGHT) / x over the horizon and its width over x across."""
    lateral, drop, _, _ = ray_grid()
    for x in (8.0, 12.0, 24.0):
        hits = cast_rays(world((x + 2, 1, 0, 4, 2, 2.5, VEHICLE)))
        face = (hits.classes == VEHICLE) & np.isclose(hits.depth, x)
        columns = (lateral * x > 0) & (lateral * x < 2)
        rows = (drop * x < CAMERA_HEIGHT) & (CAMERA_HEIGHT - drop * x < 2.5)
        np.testing.assert_array_equal(face, rows[:, None] & columns)


def test_cast_rays_top_of_low_box_from_above():
    drop = ray_grid().drop
    hits = cast_rays(world((6, 0, 0, 4, 4, 0.5, int(AgentType.STATIC))))
    row = np.argmin(np.abs(drop - (CAMERA_HEIGHT - 0.5) / 6))  # meets the top about its middle
    middle = hits.depth.shape[1] // 2
    assert hits.classes[row, middle] == AgentType.STATIC
    np.testing.assert_allclose(hits.depth[row, middle], (CAMERA_HEIGHT - 0.5) / drop[row], rtol=1e-5)


def inside_solid(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Whether points [n, 3] lie in a box that stands on the ground, or below the ground."""
    inside = points[:, 2] < 0
    for x, y, _, _, cos, sin, length, width, height in np.asarray(scene.agents, np.float64)[1:]:
        dx, dy = points[:, 0] - x, points[:, 1] - y
        along, across = dx * cos + dy * sin, dy * cos - dx * sin
        inside |= (np.abs(along) < length / 2) & (np.abs(across) < width / 2) & (points[:, 2] < height)
    return inside


@pytest.mark.parametrize("seed", range(4))
def test_cast_rays_ends_at_first_hit(seed):
    rng = np.random.default_rng(seed)
    boxes = [
        (*rng.uniform([3, -20], [50, 20]), rng.uniform(0, 360), *rng.uniform(0.5, [8, 3, 3.5]), int(rng.integers(4)))
        for _ in range(12)
    ]
    scene = world(*boxes)
    hits, (lateral, drop, _, on_map) = cast_rays(scene), ray_grid()
    for _ in range(300):
        i, j = rng.integers(len(drop)), rng.integers(len(lateral))
        depths = np.concatenate([np.arange(0.02, hits.depth[i, j] - 1e-3, 0.02), [hits.depth[i, j] + 1e-3]])
        points = np.stack([depths, lateral[j] * depths, CAMERA_HEIGHT - drop[i] * depths], 1)
        inside = inside_solid(scene, points)
        if hits.classes[i, j] != NOTHING:
            assert inside[-1]
        if hits.classes[i, j] != NOTHING or on_map[i, j]:
            assert not inside[:-1].any()


def test_cast_rays_left_is_left():
    left, right = (cast_rays(world((15, y, 0, 4, 2, 1.6, VEHICLE))) for y in (6, -6))
    assert isinstance(left, RayHits)
    np.testing.assert_array_equal(left.classes, right.classes[:, ::-1])
    columns = np.flatnonzero((left.classes == VEHICLE).any(0))
    assert columns.max() < left.classes.shape[1] // 2


def test_cast_rays_lane_is_ribbon():
    hits = cast_rays(world(lanes=[((0, 0), (64, 0))]))
    lateral, drop, _, on_map = ray_grid()
    aside = np.abs(lateral[None] * CAMERA_HEIGHT / np.where(drop > 0, drop, np.inf)[:, None])
    assert (hits.classes[on_map & (aside < 1.5)] == LANE).all()
    assert (hits.classes[on_map & (aside > 2.3)] == GROUND).all()


def test_cast_rays_ignores_padding_and_order():
    scene = example_scene(3, agents=9, lanes=6, padding=0, crop=Crop.FORWARD)
    assert same(scene, pad(scene, 20, 30))
    rng = np.random.default_rng(0)
    assert same(scene, permute(scene, np.concatenate([[0], 1 + rng.permutation(8)]), rng.permutation(6)))


def test_cast_rays_ignores_the_ego():
    scene = example_scene(3, agents=9, lanes=6, padding=0, crop=Crop.FORWARD)
    big = scene.replace(agents=np.concatenate([[[5, 0, 1, 0, 1, 0, 4, 30, 4]], scene.agents[1:]]).astype(np.float32))
    assert same(scene, big)


def test_cast_rays_refuses_batches_and_other_crops():
    with pytest.raises(ValueError, match="a CENTERED scene: crop it ahead"):
        render(example_scene())
    scene = world()
    with pytest.raises(ValueError, match=r"a batch \(1,\)"):
        cast_rays(scene.replace(**{name: value[None] for name, value in scene.to_dict().items()}))


def test_camera_view_grid_draws_four_panels_per_scene(tmp_path):
    figure = camera_view_grid([wall(10.0), world()], path=tmp_path / "ahead.png")
    assert len(figure.axes) == 8 and (tmp_path / "ahead.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="no scenes"):
        camera_view_grid([])
