"""Properties of the autoencoder: nothing outside a scene touches it, order does not matter, sides stay apart."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.convert.autoencoder import unused_sizes
from scjax.models.autoencoder import Decoded, Posterior, autoencoder, noise_like, reparameterize
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.loss import LossWeights, loss, scene_errors, scene_losses
from scjax.models.codec import NormalizedScene
from scjax.nn.functional import count
from scjax.scene import Crop
from scjax.scene.per_type import PerType
from tests.factories import parity_scenes as cases

CONFIG = AutoencoderConfig.preset("tiny", decoder_blocks=1, edge_width=6, points=4, max_lanes=12)
AGENTS, LANES = 4, 7
# Called by itself, the loss would compile a program for each of its operations.
_OPTIONS = ("weights", "official_lane_count", "balanced_links", "typical_counts")
scene_losses_of, loss_of = jax.jit(scene_losses, static_argnames=_OPTIONS), jax.jit(loss, static_argnames=_OPTIONS)
scene_errors_of = jax.jit(scene_errors)


def random_tokens(seed: int, agents: int, lanes: int, partitioned: bool, dtype=np.float64) -> NormalizedScene:
    """One scene [1, ...] of nonsense."""
    rng, c = np.random.default_rng(seed), CONFIG
    points = rng.uniform(-1, 1, (1, lanes, c.points, c.point_dims)).astype(dtype)
    states = rng.uniform(-1, 1, (1, agents, c.columns)).astype(dtype)
    return NormalizedScene(
        agents=states,
        agent_types=rng.integers(0, c.agent_types, (1, agents), np.int32),
        agent_mask=np.ones((1, agents), bool),
        agent_known=rng.random((1, agents, c.columns)) < 0.7,
        agent_behind=partitioned & (states[..., 0] <= 0),
        lanes=points,
        lane_types=rng.integers(0, c.lane_types, (1, lanes), np.int32),
        lane_type_known=rng.random((1, lanes)) < 0.7,
        lane_mask=np.ones((1, lanes), bool),
        lane_known=rng.random((1, lanes, c.point_dims)) < 0.7,
        lane_behind=partitioned & (points[:, :, 1, 0] <= 0),
        links=rng.integers(0, c.link_types, (1, lanes, lanes), np.int32),
        crop=np.array([Crop.PARTITIONED if partitioned else Crop.CENTERED], np.int32),
        domain=np.zeros(1, np.int32),
    )


def random_nodes(seed: int, agents: int, lanes: int, dtype=np.float64) -> PerType:
    """Noise [1, ...]."""
    rng = np.random.default_rng(seed)
    return PerType(
        agents=rng.normal(size=(1, agents, CONFIG.agent_latent)).astype(dtype),
        lanes=rng.normal(size=(1, lanes, CONFIG.lane_latent)).astype(dtype),
    )


def pair(dtype=np.float64, garbage: float | None = None) -> tuple[NormalizedScene, PerType]:
    """A partitioned scene and a smaller one, with padding."""
    tokens = [random_tokens(1, AGENTS, LANES, True, dtype), random_tokens(2, 2, 3, False, dtype)]
    noise = [random_nodes(3, AGENTS, LANES, dtype), random_nodes(4, 2, 3, dtype)]
    sizes = AGENTS + 1, LANES + 2
    return (
        cases.concatenate(*(cases.padded(t, *sizes, garbage) for t in tokens)),
        cases.concatenate(*(cases.padded_nodes(n, *sizes, garbage) for n in noise)),
    )


@pytest.fixture(scope="module")
def params():
    """Random everywhere: also scales and offsets, so that no branch is idle."""
    shapes = jax.eval_shape(autoencoder(CONFIG).init, jax.random.key(0))
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        return jax.tree.map(lambda s: jnp.asarray(rng.normal(size=s.shape) * 0.4 + 0.1), shapes)


@pytest.fixture(scope="module")
def run():
    """Posterior, decoded scene, loss terms per scene and the gradient of their sum, in float64."""
    apply = autoencoder(CONFIG).apply

    def total(params, tokens, noise):
        posterior, decoded = apply(params, tokens, noise, method="reconstruct")
        terms = scene_losses(decoded, posterior, tokens, balanced_links=True)
        return terms["total"].sum(), (posterior, decoded, terms)

    def everything(params, tokens, noise):
        (_, results), gradient = jax.value_and_grad(total, has_aux=True)(params, tokens, noise)
        return *results, gradient

    jitted = jax.jit(everything, compiler_options={"xla_backend_optimization_level": 0})

    def run(*args):
        with jax.enable_x64(True):
            return jax.device_get(jitted(*args))

    return run


@pytest.fixture(scope="module")
def reference(run, params):
    return run(params, *pair())


def assert_close(result, expected, tolerance: float):
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, tolerance, tolerance), result, expected)


def test_scene_equals_itself_in_a_padded_batch(run, params):
    """Values to 1e-10, and the batch's gradient is the sum of the scenes' to 1e-10."""
    *both, gradient = run(params, *pair(garbage=np.nan))
    sizes = AGENTS, LANES
    singles = [
        run(params, random_tokens(1, *sizes, True), random_nodes(3, *sizes)),
        run(
            params,
            cases.padded(random_tokens(2, 2, 3, False), *sizes),
            cases.padded_nodes(random_nodes(4, 2, 3), *sizes),
        ),
    ]
    for row, (*single, _) in enumerate(singles):
        for batched, alone in zip(jax.tree.leaves(both), jax.tree.leaves(single), strict=True):
            assert batched.dtype == np.float64
            shared = batched[row][tuple(slice(n) for n in alone[0].shape)]
            np.testing.assert_allclose(shared, alone[0], 1e-10, 1e-10)
    assert_close(gradient, jax.tree.map(np.add, singles[0][-1], singles[1][-1]), 1e-10)


def test_padding_values_change_no_bit(run, params, reference):
    for garbage in (np.nan, 1e30):
        for result, expected in zip(
            jax.tree.leaves(run(params, *pair(garbage=garbage))), jax.tree.leaves(reference), strict=True
        ):
            np.testing.assert_array_equal(result, expected)


def test_float32_is_close_to_float64(params, reference):
    def forward(params, tokens, noise):
        return autoencoder(CONFIG).apply(params, tokens, noise, method="reconstruct")

    params = jax.tree.map(lambda x: np.asarray(x, np.float32), params)
    result = jax.jit(forward)(jax.device_put(params), *pair(np.float32, garbage=1e30))
    for value, expected in zip(jax.tree.leaves(result), jax.tree.leaves(reference[:2]), strict=True):
        assert value.dtype == np.float32
        np.testing.assert_allclose(value, expected, 1e-4, 1e-4)


def test_padding_rows_are_zero(reference):
    posterior, decoded, *_ = reference
    tokens, _ = pair()
    for array in (posterior.mean.lanes, posterior.logvar.lanes, decoded.lanes, decoded.lane_type_logits):
        assert not array[~tokens.lane_mask].any()
    for array in (posterior.mean.agents, posterior.logvar.agents, decoded.agents, decoded.agent_type_logits):
        assert not array[~tokens.agent_mask].any()
    assert not decoded.link_logits[~(tokens.lane_mask[:, :, None] & tokens.lane_mask[:, None])].any()


def test_autoencoder_is_permutation_equivariant(run, params, reference):
    tokens, noise = pair()
    agents, lanes = np.random.default_rng(0).permutation(AGENTS), np.random.default_rng(1).permutation(LANES)
    agents = np.concatenate([agents, np.arange(AGENTS, tokens.agent_mask.shape[1])])
    lanes = np.concatenate([lanes, np.arange(LANES, tokens.lane_mask.shape[1])])

    def permuted(tree):
        fields = {name: getattr(tree, name) for name in tree.__dataclass_fields__}
        for name, value in fields.items():
            if name == "links" or name == "link_logits":
                fields[name] = value[:, lanes][:, :, lanes]
            elif isinstance(value, PerType):
                fields[name] = permuted(value)
            elif name.startswith(("agent", "lane")) and name != "lane_count_logits":
                fields[name] = value[:, agents if name.startswith("agent") else lanes]
        return type(tree)(**fields)

    posterior, decoded, terms, gradient = run(params, permuted(tokens), permuted(noise))
    expected = permuted(reference[0]), permuted(reference[1]), *reference[2:]
    assert_close((posterior, decoded, terms, gradient), expected, 1e-10)


def test_partition_separates_latents(run, params, reference):
    tokens, noise = pair()
    after_lanes, after_agents = ~tokens.lane_behind, ~tokens.agent_behind
    after_lanes[1], after_agents[1] = False, False  # the other scene is not partitioned
    rows, columns = after_lanes[:, :, None], after_lanes[:, None]
    changed = tokens.replace(
        lanes=np.where(after_lanes[..., None, None], -3 * tokens.lanes, tokens.lanes),
        agents=np.where(after_agents[..., None], -3 * tokens.agents, tokens.agents),
        lane_types=np.where(after_lanes, (tokens.lane_types + 1) % CONFIG.lane_types, tokens.lane_types),
        links=np.where(rows | columns, (tokens.links + 1) % CONFIG.link_types, tokens.links),
    )
    posterior, old = run(params, changed, noise)[0], reference[0]
    for moment in ("mean", "logvar"):
        for kind, before in (("lanes", tokens.lane_behind[0]), ("agents", tokens.agent_behind[0])):
            new, was = getattr(getattr(posterior, moment), kind)[0], getattr(getattr(old, moment), kind)[0]
            assert before.any() and (~before).any()
            np.testing.assert_array_equal(new[before], was[before])
            assert np.abs(new[~before] - was[~before]).max() > 1e-3
    np.testing.assert_array_equal(posterior.lane_count_logits, old.lane_count_logits)


def test_unknown_values_are_flagged_and_not_in_the_loss(run, params, reference):
    tokens, noise = pair()
    known = tokens.agent_known.copy()
    known[0, 0, 6] = ~known[0, 0, 6]
    posterior = run(params, tokens.replace(agent_known=known), noise)[0]
    assert np.abs(posterior.mean.agents[0, 0] - reference[0].mean.agents[0, 0]).max() > 1e-4
    decoded = reference[1]
    hidden = tokens.replace(
        agents=np.where(tokens.agent_known, tokens.agents, np.nan),
        lanes=np.where(tokens.lane_known[:, :, None], tokens.lanes, np.nan),
        lane_types=np.where(tokens.lane_type_known, tokens.lane_types, -1),
    )
    with jax.enable_x64(True):
        terms = scene_losses_of(decoded, reference[0], hidden, balanced_links=True)
    for name in ("agent_states", "lane_points", "lane_type"):
        np.testing.assert_allclose(terms[name], reference[2][name], 1e-10, 1e-10)


def test_official_preset_parameter_count():
    config = AutoencoderConfig.preset("official")
    used = count(jax.eval_shape(autoencoder(config).init, jax.random.key(0)))
    unused = unused_sizes(config)
    assert sum(n for key, n in unused.items() if "prenorm" in key) == 3_072
    assert sum(n for key, n in unused.items() if "update_edge" in key) == 91_264
    assert used + sum(unused.values()) == 32_434_148


def test_presets_are_ordered_by_size():
    configs = [AutoencoderConfig.preset(name) for name in ("tiny", "small", "base", "official")]
    sizes = [count(jax.eval_shape(autoencoder(config).init, jax.random.key(0))) for config in configs]
    assert sizes == sorted(sizes)


@pytest.mark.parametrize(
    "changes, word",
    [
        ({"lane_heads": 5}, "divisible"),
        ({"point_dims": 4}, "point_dims"),
        ({"encoder_blocks": 0}, "encoder_blocks"),
        ({"columns": 7}, "known_inputs"),
    ],
)
def test_config_rejects_bad_sizes(changes, word):
    with pytest.raises(ValueError, match=word):
        AutoencoderConfig.preset("tiny", **changes)


def test_encode_rejects_tokens_of_another_codec(params):
    tokens, noise = pair()
    apply = autoencoder(CONFIG).apply
    with pytest.raises(ValueError, match="with the codec of this model"):
        apply(params, tokens.replace(lanes=tokens.lanes[..., :2]), method="encode")
    with pytest.raises(ValueError, match=r"latents\.lanes"):
        mask = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        apply(params, noise.replace(lanes=noise.lanes[..., 1:]), mask, method="decode")


def by_hand(links, link_logits) -> tuple[Decoded, Posterior, NormalizedScene]:
    """A scene of perfect reconstruction but for the links [1, 2, 2]."""
    tokens = random_tokens(0, 1, 2, False, np.float32).replace(links=np.asarray(links, np.int32))
    decoded = Decoded(
        agents=tokens.agents,
        agent_type_logits=30 * np.eye(4, dtype=np.float32)[tokens.agent_types],
        lanes=tokens.lanes,
        lane_type_logits=30 * np.eye(4, dtype=np.float32)[tokens.lane_types],
        link_logits=np.asarray(link_logits, np.float32),
    )
    zeros = PerType(agents=np.zeros((1, 1, 10), np.float32), lanes=np.zeros((1, 2, 24), np.float32))
    return decoded, Posterior(mean=zeros, logvar=zeros, lane_count_logits=np.zeros((1, 13), np.float32)), tokens


def test_balanced_link_loss_by_hand():
    """Three pairs of class 0 with cross-entropy log(1 + 5/e), one of class 1 with log 6."""
    logits = np.zeros((1, 2, 2, 6))
    logits[..., 0] = 1.0
    logits[0, 0, 1, 0] = 0.0
    case = by_hand([[[0, 1], [0, 0]]], logits)
    common, rare = np.log(1 + 5 / np.e), np.log(6)
    plain = scene_losses_of(*case)
    np.testing.assert_allclose(plain["lane_connection"], [(3 * common + rare) / 4], 1e-6)
    balanced = scene_losses_of(*case, balanced_links=True)
    np.testing.assert_allclose(balanced["lane_connection"], [(common + rare) / 2], 1e-6)
    value, logged = loss_of(*case, LossWeights(lane_connection=2.0), balanced_links=True)
    np.testing.assert_allclose(value, common + rare, 1e-5)
    assert logged["kl"] == 0 and logged["agent_states"] == 0


def test_lane_count_loss_depends_on_the_crop():
    case = by_hand(np.zeros((1, 2, 2)), np.zeros((1, 2, 2, 6)))
    for crop, official, ours in ((Crop.CENTERED, 0, 0), (Crop.PARTITIONED, 1, 1), (Crop.FORWARD, 1, 0)):
        tokens = case[2].replace(crop=np.array([crop], np.int32))
        for flag, factor in ((True, official), (False, ours)):
            term = scene_losses_of(case[0], case[1], tokens, official_lane_count=flag)["lane_count"]
            np.testing.assert_allclose(term, [factor * np.log(13)], 1e-6)


def test_typical_counts_weigh_elements_equally(reference):
    """Coordinates weigh by how many there are over the typical number; classes and the rest stay as they are."""
    posterior, decoded = reference[:2]
    tokens = pair()[0]
    weights = LossWeights(agent_states=2.0, lane_points=3.0, lane_connections=5.0, lane_steps=7.0)
    with jax.enable_x64(True):
        plain, shared = jax.device_get(
            (
                scene_losses_of(decoded, posterior, tokens, weights),
                scene_losses_of(decoded, posterior, tokens, weights, typical_counts=(4.0, 2.0)),
            )
        )
    by_lanes = 3 * plain["lane_points"] + 5 * plain["lane_connections"] + 7 * plain["lane_steps"]
    more = (tokens.agent_mask.sum(-1) / 4 - 1) * 2 * plain["agent_states"] + (
        tokens.lane_mask.sum(-1) / 2 - 1
    ) * by_lanes
    assert (np.abs(more) > 0.1).all()
    np.testing.assert_allclose(shared["total"] - plain["total"], more, rtol=1e-9)
    for name in plain.keys() - {"total"}:
        np.testing.assert_array_equal(shared[name], plain[name])
    for wrong in ((8.0,), (8.0, 0.0)):
        with pytest.raises(ValueError, match="typical_counts must be two numbers above 0"):
            scene_losses_of(decoded, posterior, tokens, typical_counts=wrong)


def test_connection_loss_ignores_shared_errors():
    """Both ends of a joint moved alike cost nothing; one moved by (0.3, 0.1, 0) costs the mean of the three."""
    case = by_hand([[[0, 1], [2, 0]]], np.zeros((1, 2, 2, 6)))
    case = (*case[:2], case[2].replace(lane_known=np.ones_like(case[2].lane_known)))
    weights = LossWeights(lane_connections=1.0)
    moved = case[0].replace(lanes=case[0].lanes + np.array([0.3, 0.1, 0.0]))
    np.testing.assert_allclose(scene_losses_of(moved, *case[1:], weights)["lane_connections"], [0.0], atol=1e-6)
    lanes = np.array(case[0].lanes)
    lanes[0, 1, 0] += [0.3, 0.1, 0.0]  # the start of the second lane
    lanes[0, 0, 0] += 5.0  # the start of the first joins nothing
    apart = case[0].replace(lanes=lanes)
    np.testing.assert_allclose(scene_losses_of(apart, *case[1:], weights)["lane_connections"], [0.4 / 3], 1e-5)
    unlinked = case[2].replace(links=np.zeros_like(case[2].links))
    assert scene_losses_of(apart, case[1], unlinked, weights)["lane_connections"] == 0


def test_step_loss_ignores_shifts():
    case = by_hand(np.zeros((1, 2, 2)), np.zeros((1, 2, 2, 6)))
    case = (*case[:2], case[2].replace(lane_known=np.ones_like(case[2].lane_known)))
    weights = LossWeights(lane_steps=1.0)
    lanes = np.array(case[2].lanes)
    add_bias = case[0].replace(lanes=lanes + np.array([0.3, 0.1, 0.0]))
    np.testing.assert_allclose(scene_losses_of(add_bias, *case[1:], weights)["lane_steps"], [0.0], atol=1e-6)
    inner = lanes.shape[2] // 2
    lanes[0, 0, inner] += [0.3, 0.0, 0.0]  # one point of the first lane: the steps before and after it are off
    steps = 2 * (lanes.shape[2] - 1) * 3
    trembling = case[0].replace(lanes=lanes)
    np.testing.assert_allclose(scene_losses_of(trembling, *case[1:], weights)["lane_steps"], [2 * 0.3 / steps], 1e-5)


def test_scene_errors_by_hand():
    logits = np.zeros((1, 2, 2, 6))
    logits[0, 0, 1, 1] = logits[0, 1, 0, 3] = 1.0
    decoded, _, tokens = by_hand([[[5, 1], [2, 5]]], logits)
    result = scene_errors_of(decoded.replace(lanes=decoded.lanes + np.array([0.3, 0.4, 9.0])), tokens)
    np.testing.assert_allclose(result["lane_points"], [0.5], 1e-5)
    assert result["agent_types"] == 1 and result["agent_positions"] == 0 and result["agent_headings"] < 1e-6
    assert (result["link_hits"], result["link_true"], result["link_predicted"]) == (1, 2, 2)


def test_reparameterize_has_the_posterior_moments():
    mean = PerType(agents=jnp.full((1, 2000, 10), 2.0), lanes=jnp.full((1, 2000, 24), -1.0))
    logvar = jax.tree.map(lambda x: jnp.full_like(x, 2 * np.log(0.5)), mean)
    posterior = Posterior(mean=mean, logvar=logvar, lane_count_logits=jnp.zeros((1, 13)))
    sample = reparameterize(jax.random.key(0), posterior)
    np.testing.assert_allclose(sample.agents.mean(), 2.0, atol=0.02)
    np.testing.assert_allclose(sample.lanes.std(), 0.5, atol=0.01)
    assert abs(np.corrcoef(sample.agents.ravel(), sample.lanes.ravel()[: sample.agents.size])[0, 1]) < 0.05


def test_noise_like_has_latent_shapes():
    tokens, _ = pair(np.float32)
    noise = noise_like(jax.random.key(0), tokens, CONFIG)
    assert noise.agents.shape == (2, AGENTS + 1, 10) and noise.lanes.shape == (2, LANES + 2, 24)
