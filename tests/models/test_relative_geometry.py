"""What tokens learn of what lies near them; and that a fresh network does not use it."""

import jax
import jax.numpy as jnp
import numpy as np

from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.models.denoiser.position_head import POINTS
from scjax.models.denoiser.relative_geometry import agent_geometry, lane_geometry
from scjax.nn.functional import flatten, unflatten
from scjax.scene.per_type import PerType
from tests.factories import golden

SIZES = {
    "lane_width": 16,
    "lane_heads": 2,
    "agent_width": 8,
    "agent_heads": 2,
    "blocks": 1,
    "mlp_ratio": 2,
    "lane_latent": 5,
    "agent_latent": 3,
    "max_lanes": 9,
    "max_agents": 7,
}


_of_lanes, _of_agents = jax.jit(lane_geometry), jax.jit(agent_geometry)


def _lane(start, end):
    return np.linspace(start, end, POINTS.lanes)


def _weight(distance, scale):
    return np.exp(-0.5 * (distance / scale) ** 2)


def test_lane_geometry_points_to_the_next_lane():
    """One lane ends at (10, 0); another begins 0.6 m ahead and 0.8 m left of there, a third far away."""
    lanes = jnp.asarray([[_lane((-5, 0), (10, 0)), _lane((10.6, 0.8), (25, 3)), _lane((0, 900), (0, 950))]])
    numbers = np.asarray(_of_lanes(lanes, jnp.ones((1, 3), bool)))[0].reshape(3, 5, 3, 3)  # pairing, scale, numbers
    for k, scale in enumerate((1.0, 3.0, 9.0)):
        weight = _weight(1.0, scale)
        shift = weight / (weight + 0.1) / scale
        np.testing.assert_allclose(numbers[0, 0, k], [0.6 * shift, 0.8 * shift, weight / (1 + weight)], atol=1e-5)
        np.testing.assert_allclose(numbers[1, 1, k], [-0.6 * shift, -0.8 * shift, weight / (1 + weight)], atol=1e-5)
    assert not numbers[2].any() and np.abs(numbers[0, 3, 0]).max() < 1e-6  # nothing ends where the first lane does


def test_agent_geometry_points_to_lane_and_agents():
    lane = jnp.asarray([[_lane((-20, 0), (20, 0))]])
    agents = jnp.asarray([[[(3.0, 1.5), (13.0, 1.5)], [(6.0, 1.5), (16.0, 1.5)]]])
    masks = PerType(agents=jnp.ones((1, 2), bool), lanes=jnp.ones((1, 1), bool))
    numbers = np.asarray(_of_agents(agents, lane, masks))[0, 0]
    for k, scale in enumerate((2.0, 4.0, 8.0)):
        weight = _weight(3.0, scale)
        np.testing.assert_allclose(
            numbers[3 * k : 3 * k + 3], [3 / scale * weight / (weight + 0.1), 0, weight / (1 + weight)], atol=1e-5
        )
    for k, scale in enumerate((1.0, 2.0, 4.0)):
        shift_x, shift_y, _, along, across = numbers[9 + 5 * k : 14 + 5 * k]
        assert -1.5 / scale < shift_y < 0 and along > 0.5
        # Segments that end before the agent pull along the lane; where the foot lies, nothing does.
        assert abs(across) < 1e-6 and abs(shift_x) < 1


def test_geometry_ignores_translation_and_padding():
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        lanes, agents = rng.normal(0, 4, (2, 5, POINTS.lanes, 2)), rng.normal(0, 4, (2, 4, 2, 2))
        masks = PerType(
            agents=jnp.arange(4)[None] < jnp.array([[4], [2]]), lanes=jnp.arange(5)[None] < jnp.array([[3], [5]])
        )

        def geometry(lanes, agents):
            lanes, agents = jnp.asarray(lanes), jnp.asarray(agents)
            both = _of_agents(agents, lanes, masks), _of_lanes(lanes, masks.lanes)
            return [np.asarray(x)[np.asarray(mask)] for x, mask in zip(both, (masks.agents, masks.lanes), strict=True)]

        unchanged = geometry(lanes, agents)
        for result, expected in zip(geometry(lanes + 7, agents + 7), unchanged, strict=True):
            np.testing.assert_allclose(result, expected, atol=1e-12)
        spoilt = (
            np.where(np.asarray(masks.lanes)[..., None, None], lanes, 0.3),
            np.where(np.asarray(masks.agents)[..., None, None], agents, 0.3),
        )
        for result, expected in zip(geometry(*spoilt), unchanged, strict=True):
            np.testing.assert_allclose(result, expected, atol=1e-12)


def test_fresh_relative_geometry_is_zero():
    rng = np.random.default_rng(0)
    masks = PerType(agents=np.arange(4)[None] < np.array([[4], [2]]), lanes=np.arange(6)[None] < np.array([[3], [6]]))
    widths = PerType(agents=3, lanes=5)
    z = jax.tree.map(lambda m, w: rng.normal(size=(*m.shape, w)).astype(np.float32), masks, widths)
    hinted, plain = (denoiser(DenoiserConfig(**SIZES, relative_geometry=flag)) for flag in (True, False))
    leaves = flatten(jax.device_get(hinted.init(jax.random.key(0))))
    assert not any(np.any(leaf) for path, leaf in leaves.items() if path[0] == "relative_geometry")
    noisy = {path: leaf + 0.3 * rng.normal(size=leaf.shape).astype(np.float32) for path, leaf in leaves.items()}
    silent = {path: 0 * leaf if path[0] == "relative_geometry" else leaf for path, leaf in noisy.items()}
    unhinted = {path: leaf for path, leaf in noisy.items() if path[0] not in ("relative_geometry", "position_heads")}

    with_hints, without = golden.jit(hinted.apply), golden.jit(plain.apply)
    t, label = np.array([3, 70]), np.array([0, 5])
    expected = without(unflatten(unhinted), z, t, label, masks)
    result = with_hints(unflatten(silent), z, t, label, masks)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-5), result, expected)
    heard = with_hints(unflatten(noisy), z, t, label, masks)
    assert all(np.abs(x - y).max() > 1e-2 for x, y in zip(*map(jax.tree.leaves, (heard, expected)), strict=True))
