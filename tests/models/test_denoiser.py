"""What must hold of any denoiser: padding, batch and garbage never matter, null conditions, sizes, options."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models.denoiser.attribute_embedding import AttributeEmbedding
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ImageFeatures, TextFeatures
from scjax.models.denoiser.model import Denoiser, denoiser
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.nn.functional import count, functional
from scjax.scene.per_type import PerType
from tests.factories import golden
from tests.factories.initial_values import initial_params

SMALLEST = {
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
    "known_embedding": True,
    "fourier_features": 2,
    "relative_geometry": True,
    "cross_attention": CrossGlobalOptions(latent_tokens=3),
}
FOURIER = ("agent_fourier", "lane_fourier")
TEXT = TextCondition(width=6)
SIZES = ((4, 5), (6, 8), (1, 2))  # (agents, lanes) of the test's scenes
ROWS = (6, 8)


def _network(condition=TEXT, **changes):
    return denoiser(DenoiserConfig(condition=condition, **SMALLEST, **changes))


@functools.cache
def _params(condition=TEXT, *, noise=0.2, **changes):
    """All parameters random, so that no branch is inactive; with noise 0 as training starts with them."""
    config = DenoiserConfig(condition=condition, **SMALLEST, **changes)
    return initial_params(lambda init: Denoiser(config, init=init), noise=noise)


def _scenes():
    """(z, t, label, masks, given, features) of the three scenes in one batch, padding zero."""
    rng = np.random.default_rng(0)
    masks = PerType(
        agents=np.arange(ROWS[0])[None] < np.array(SIZES)[:, :1],
        lanes=np.arange(ROWS[1])[None] < np.array(SIZES)[:, 1:],
    )
    widths = PerType(agents=3, lanes=5)
    z = jax.tree.map(
        lambda mask, width: np.where(mask[..., None], rng.normal(size=(*mask.shape, width)), 0), masks, widths
    )
    known = jax.tree.map(lambda mask: mask & (rng.random(mask.shape) < 0.4), masks)
    read = np.arange(7)[None] < np.array([3, 7, 5])[:, None]
    features = TextFeatures(tokens=np.where(read[..., None], rng.normal(size=(3, 7, 6)), 0), mask=read)
    return z, np.array([3, 99, 40]), np.array([0, 5, 12]), masks, known, features


def _loss_of_first(params, z, t, label, masks, known, features, dropped):
    """A function of the first scene of the batch only."""
    network = _network()
    cache = network.apply(params, features, dropped, method="encode_condition")
    eps = network.apply(params, z, t, label, masks, known, cache)
    first = jax.tree.map(lambda x, mask: jnp.where(mask[0][:, None], jnp.sin(x[0]), 0).sum(), eps, masks)
    return first.agents + first.lanes, eps


_evaluate = golden.jit(_loss_of_first)
_gradient = golden.jit(jax.value_and_grad(_loss_of_first, (0, 1), has_aux=True))


def _estimate(params, *arguments):
    """In float32, in which only the program of gradients is compiled."""
    return _gradient(params, *arguments)[0][1]


@golden.jit
def _unconditional(params, z, t, label, masks, known):
    return _network(None).apply(params, z, t, label, masks, known)


GARBAGE = (np.nan, 1e30)


def _batch(dtype, garbage):
    """Arguments of ``_loss_of_first`` after the parameters: the condition of the last scene is dropped."""
    z, t, label, masks, known, features = _scenes()
    dropped = np.array([False, False, True])
    valid = features.mask & ~dropped[:, None]
    spoilt = jax.tree.map(lambda x, mask: np.where(mask[..., None], x, garbage), z, masks)
    tokens = np.where(valid[..., None], features.tokens, garbage)
    return _cast((spoilt, t, label, masks, known, features.replace(tokens=tokens), dropped), dtype)


def _cast(tree, dtype=jnp.float32):
    """On the device; ``jnp.asarray`` would compile for every shape."""
    return jax.device_put(jax.tree.map(lambda x: np.asarray(x, dtype if x.dtype.kind == "f" else None), tree))


def _cut(pair):
    return PerType(agents=pair.agents[:1, : SIZES[0][0]], lanes=pair.lanes[:1, : SIZES[0][1]])


@pytest.fixture(scope="module")
def alone():
    """The first scene, alone and unpadded, in float64: estimates, and gradients by parameters and latents."""
    z, t, label, masks, known, features = _scenes()
    read = int(features.mask[0].sum())
    short = features.replace(tokens=features.tokens[:1, :read], mask=features.mask[:1, :read])
    scene = (_cut(z), t[:1], label[:1], _cut(masks), _cut(known), short, np.zeros(1, bool))
    with jax.enable_x64(True):
        (_, eps), gradients = _gradient(*_cast((_params(), *scene), jnp.float64))
    return eps, *gradients


def _assert_close(x, y, tolerance):
    scale = max(1.0, np.abs(y).max(initial=0))
    np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance * scale)


@pytest.mark.parametrize("garbage", GARBAGE)
def test_padding_and_batch_never_matter(alone, garbage):
    """The first scene alone, against in a batch whose padding and dropped conditions are garbage."""
    with jax.enable_x64(True):
        _, many = _evaluate(_cast(_params(), jnp.float64), *_batch(jnp.float64, garbage))
    jax.tree.map(functools.partial(_assert_close, tolerance=1e-10), _cut(many), alone[0])
    assert all(leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(many))


@pytest.mark.parametrize("garbage", GARBAGE)
def test_gradients_never_depend_on_padding_and_batch(alone, garbage):
    """In float32, in which the squares of garbage are infinite."""
    close = functools.partial(_assert_close, tolerance=1e-5)
    (_, many), (many_of_params, many_of_z) = _gradient(_cast(_params()), *_batch(jnp.float32, garbage))
    jax.tree.map(close, (_cut(many), many_of_params, _cut(many_of_z)), alone)
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves((many, many_of_params)))
    for leaf, mask in zip(jax.tree.leaves(many), jax.tree.leaves(_scenes()[3]), strict=True):
        assert not np.any(np.asarray(leaf)[~mask])
    assert not any(np.any(np.asarray(leaf)[1:]) for leaf in jax.tree.leaves(many_of_z))


def test_dropped_and_empty_conditions_are_unconditional():
    z, t, label, masks, known, features = _cast(_scenes())
    shared = {name: leaf for name, leaf in _params().items() if name != "context"}
    shared["blocks"] = {i: {n: _without_cross(n, s) for n, s in b.items()} for i, b in shared["blocks"].items()}
    expected = _unconditional(shared, z, t, label, masks, known)
    empty = features.replace(mask=jnp.zeros_like(features.mask))
    for case, dropped in ((features, jnp.ones(3, bool)), (empty, jnp.zeros(3, bool))):
        eps = _estimate(_params(), z, t, label, masks, known, case, dropped)
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-6, atol=1e-6), eps, expected)


def test_shorter_cache_conditions_the_first_scenes():
    z, t, label, masks, known, features = _cast(_scenes())
    dropped = jnp.array([False, True, True])
    expected = _estimate(_params(), z, t, label, masks, known, features, dropped)

    @golden.jit
    def shorter(params, features):
        cache = _network().apply(params, features, dropped[:1], method="encode_condition")
        return _network().apply(params, z, t, label, masks, known, cache)

    eps = shorter(_params(), jax.tree.map(lambda x: x[:1], features))
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-6), eps, expected)


def _without_cross(name, stage):
    if name == "l2l":
        return {i: _without_cross("", each) for i, each in stage.items()}
    return {part: leaf for part, leaf in stage.items() if not part.startswith("cross")}


def test_fresh_network_estimates_zero():
    params = _params(noise=0)
    z, t, label, masks, known, features = _cast(_scenes())
    eps = _estimate(params, z, t, label, masks, known, features, jnp.zeros(3, bool))
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(eps))
    crossed = [params["blocks"][0][name]["cross_adaln"] for name in ("a2l", "l2a", "a2a")]
    assert not any(np.any(leaf) for leaf in jax.tree.leaves(crossed))
    assert not np.any(params["blocks"][0]["a2l"]["cross"]["gate"])


def test_precomputed_modulation_is_equal():
    z, t, label, masks, known, _ = _cast(_scenes())
    network, params = _network(None), _params(None)

    @golden.jit
    def through(params, z, t, label, masks, known):
        counts = jax.tree.map(lambda mask: mask.sum(-1, dtype=jnp.int32), masks)
        modulation = network.apply(params, t, label, counts, method="modulation")
        return network.apply(params, z, 0 * t, 0 * label, masks, known, modulation=modulation)

    arguments = params, z, t, label, masks, known
    jax.tree.map(
        functools.partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-6),
        through(*arguments),
        _unconditional(*arguments),
    )


def test_positions_count_valid_tokens():
    """Holes in the mask: a token's code is its rank among the valid ones."""
    z, t, label, masks, known, _ = _cast(_scenes())
    spread = np.array([0, 2, 3, 5, 7])  # the five lanes of the first scene among eight rows
    holes = masks.replace(lanes=masks.lanes.at[0].set(False).at[0, spread].set(True))
    move = lambda x: jnp.zeros_like(x).at[1:].set(x[1:]).at[0, spread].set(x[0, :5])  # noqa: E731
    direct = _unconditional(_params(None), z, t, label, masks, known)
    moved = _unconditional(
        _params(None), z.replace(lanes=move(z.lanes)), t, label, holes, known.replace(lanes=move(known.lanes))
    )
    np.testing.assert_allclose(moved.lanes[0, spread], direct.lanes[0, :5], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(moved.agents, direct.agents, rtol=1e-5, atol=1e-6)


def test_known_embedding_marks_known_tokens():
    z, t, label, masks, known, _ = _cast(_scenes())
    nothing = jax.tree.map(jnp.zeros_like, known)
    marked, unmarked = (_unconditional(_params(None), z, t, label, masks, flags) for flags in (known, nothing))
    assert all(np.abs(x - y).max() > 1e-3 for x, y in zip(*map(jax.tree.leaves, (marked, unmarked)), strict=True))


def test_a_request_for_nothing_adds_nothing():
    embedding = functional(lambda init: AttributeEmbedding(3, 8, init=init))
    fresh = embedding.init(jax.random.key(0))
    params = jax.tree.map(lambda leaf: leaf + 0.1, fresh)
    requested = jnp.eye(3)
    assert not embedding.apply(fresh, requested).any()
    assert embedding.apply(params, requested).all() and not embedding.apply(params, 0 * requested).any()


def test_requests_change_the_modulation():
    attributes = "layout=T", "vehicles>=1"
    network, params = _network(None, attributes=attributes), _params(None, attributes=attributes)
    _, t, label, masks, *_ = _cast(_scenes())
    counts = jax.tree.map(lambda mask: mask.sum(-1), masks)

    @golden.jit
    def lane_head_of(params, attributes):
        return network.apply(params, t, label, counts, attributes, method="modulation")["heads"].lanes

    lane_head = functools.partial(lane_head_of, params)
    nothing = jnp.zeros((len(label), 2))
    np.testing.assert_array_equal(lane_head(nothing), lane_head(None))
    changed = np.abs(lane_head(nothing.at[0, 1].set(1.0)) - lane_head(nothing)).max((1, 2))
    assert changed[0] > 1e-3 and not changed[1:].any()


def test_fresh_fourier_features_are_zero():
    z, t, label, masks, known, _ = _cast(_scenes())
    params, plain = _params(None), denoiser(DenoiserConfig(**{**SMALLEST, "fourier_features": 0}))
    fresh = {**params, **{name: _params(None, noise=0)[name] for name in FOURIER}}
    without = {name: value for name, value in params.items() if name not in FOURIER}
    expected = golden.jit(plain.apply)(without, z, t, label, masks, known)
    silent = _unconditional(fresh, z, t, label, masks, known)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-6), silent, expected)
    assert np.abs(_unconditional(params, z, t, label, masks, known).lanes - expected.lanes).max() > 1e-3


@pytest.mark.parametrize(
    ("condition", "parameters"), [(None, 345_145_890), (TextCondition(), 556_719_658), (ImageCondition(), 544_015_402)]
)
def test_official_preset_parameter_counts(condition, parameters):
    """As the release counts: its fixed position tables included."""
    config = DenoiserConfig.preset("official", condition=condition)
    abstract = jax.eval_shape(denoiser(config).init, jax.random.key(0))
    assert config.position_table_size == 236_032 + 401_408 * isinstance(condition, ImageCondition)
    assert count(abstract) + config.position_table_size == parameters


@pytest.mark.parametrize("preset", ["base", "small", "tiny"])
def test_presets_are_valid(preset):
    config = DenoiserConfig.preset(preset, condition=TEXT, domains=3)
    assert config.null_label == 9 and config.known_embedding


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lane_heads": 3}, "multiple of lane_heads"),
        ({"blocks": 0}, "positive integer"),
        ({"fourier_features": -1}, "fourier_features must be a positive integer"),
        ({"agent_width": 7, "agent_heads": 1}, "even"),
    ],
)
def test_config_rejects_bad_sizes(change, message):
    with pytest.raises(ValueError, match=message):
        DenoiserConfig(**{**SMALLEST, **change})


def test_encode_condition_rejects_other_features():
    image = ImageFeatures(dino=jnp.zeros((1, 2, 3, 3)), depth=jnp.zeros((1, 8, 8)))
    text = TextFeatures(tokens=jnp.zeros((1, 2, 6)), mask=jnp.ones((1, 2), bool))
    nobody = jnp.zeros(1, bool)
    with pytest.raises(ValueError, match="unconditional"):
        _network(None).apply(_params(None), text, nobody, method="encode_condition")
    with pytest.raises(ValueError, match="TextCondition"):
        _network().apply(_params(), image, nobody, method="encode_condition")
