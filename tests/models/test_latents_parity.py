"""One training item (order, reparameterisation, latent statistics, depth) against item_*.npz, and the fixed tables."""

from __future__ import annotations

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.data.token_order import known_half, token_permutations
from scjax.models.denoiser.context import depth_cells, normalize_depth
from scjax.models.denoiser.embed import image_table, position_table, time_code
from scjax.models.latents import LatentStatistics, statistics
from scjax.scene.per_type import PerType
from tests.factories import golden


@pytest.fixture(scope="module")
def item(parity_dir):
    return golden.load(parity_dir, "item_inputs.npz"), golden.load(parity_dir, "item_outputs.npz")


def test_item_latents_parity(item):
    inputs, outputs = item
    agents, lanes = inputs["agent_states"][:, :2], inputs["lane_points"]
    perms = token_permutations(lanes, agents)
    known = known_half(lanes[perms.lanes], agents[perms.agents])
    np.testing.assert_array_equal(known.agents, outputs["agent_partition_mask"])
    np.testing.assert_array_equal(known.lanes, outputs["lane_partition_mask"])

    mean, spread, noise = (
        PerType(agents=inputs[keys[0]], lanes=inputs[keys[1]])
        for keys in (("agent_mu", "lane_mu"), ("agent_logvar", "lane_logvar"), ("noise_agent", "noise_lane"))
    )
    z = jax.tree.map(lambda m, s, n, perm: m[perm] + np.exp(0.5 * s[perm]) * n, mean, spread, noise, perms)
    stored = {kind: inputs[f"latent_mean_std_{kind}"] for kind in ("agent", "lane")}
    known = LatentStatistics(
        *(PerType(agents=float(stored["agent"][i]), lanes=float(stored["lane"][i])) for i in (0, 1))
    )
    normalised = known.normalize(z)
    back = known.denormalize(normalised)
    for kind, leaf, whole in (("agent", normalised.agents, back.agents), ("lane", normalised.lanes, back.lanes)):
        assert golden.relative(leaf, outputs[f"latents_{kind}"]) < 1e-5
        assert golden.relative(whole, outputs[f"latents_{kind}_unnormalised"]) < 1e-5


def test_item_depth_parity(item):
    inputs, outputs = item
    depth = normalize_depth(inputs["depth_metres"])
    assert golden.relative(depth, outputs["depth_normalised"]) < 1e-5
    official = inputs["depth_official_size_u8"].astype(np.float32) / 255
    cases = [(depth, "depth_resized_{}x{}", "depth_patch_mean_{}x{}")]
    cases.append((official, "depth_official_resized_{}x{}", "depth_official_patch_mean_{}x{}"))
    for values, resized_name, mean_name in cases:
        key = next(key for key in outputs if key.startswith(resized_name.split("{")[0]))
        size = outputs[key].shape
        means = next(key for key in outputs if key.startswith(mean_name.split("{")[0]))
        rows, columns = map(int, means.split("_")[-1].split("x"))
        grid = (rows, columns)
        patch = size[0] // grid[0]
        resized, means = (depth_cells(jnp.asarray(values)[None], *how)[0] for how in ((size, 1), (grid, patch)))
        assert golden.relative(resized.reshape(size), outputs[resized_name.format(*size)]) < 1e-5
        assert golden.relative(means, outputs[mean_name.format(*grid)]) < 1e-5


def test_tables_parity(parity_dir):
    expected = golden.load(parity_dir, "tables.npz")
    first = {"lane": 0, "agent": golden.config_of(parity_dir)["autoencoder"]["max_lanes"]}
    for key, reference in expected.items():
        parts = key.split("_")
        if key == "timestep_embedding_256":
            value = time_code(jnp.arange(len(reference)), jnp.float32)
        elif parts[2] == "image":
            value = image_table(*map(int, parts[3].split("x")), int(parts[4]))
        else:
            value = position_table(first[parts[2]], len(reference), int(parts[3]))
        assert golden.relative(value, reference, key) < 1e-5, key


def test_statistics_use_valid_tokens_only():
    rng = np.random.default_rng(0)
    shape = PerType(agents=(3, 4, 5), lanes=(3, 6, 7))
    init = [jax.tree.map(lambda s: rng.normal(2, 3, s), shape, is_leaf=lambda x: isinstance(x, tuple)) for _ in "ab"]
    masks = [jax.tree.map(lambda x: rng.random(x.shape[:2]) < 0.7, draw) for draw in init]
    garbage = [
        jax.tree.map(lambda x, mask: np.where(mask[..., None], x, np.nan), *pair)
        for pair in zip(init, masks, strict=True)
    ]
    result = statistics(garbage, masks)
    for kind in ("agents", "lanes"):
        values = np.concatenate([getattr(x, kind)[getattr(m, kind)] for x, m in zip(init, masks, strict=True)])
        np.testing.assert_allclose(getattr(result.mean, kind), values.mean())
        np.testing.assert_allclose(getattr(result.std, kind), values.std())
    assert LatentStatistics(**json.loads(json.dumps(dataclasses.asdict(result)))) == result
    with pytest.raises(ValueError, match="no valid agents"):
        statistics(init, [jax.tree.map(np.zeros_like, mask) for mask in masks])
