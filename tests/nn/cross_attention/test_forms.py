"""Forms of computation that must agree, caches, statistics that are fitted, and mistakes in options."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cross_attention import OPTIONS, ContextSpec, CrossGlobalOptions, build, from_name, to_config
from scjax.nn.cross_attention.base import one_of
from scjax.nn.cross_attention.clusters import kmeans, nearest
from scjax.nn.cross_attention.saap_fit import fit
from scjax.nn.cross_attention.squeezed_fit import key_scores, threshold_of, with_threshold
from scjax.nn.functional import count
from scjax.nn.init import ParamInit
from tests.factories import golden
from tests.factories.attention_cases import (
    CASES,
    IMAGE,
    KEYS,
    TEXT,
    WIDTH,
    apply,
    call,
    close,
    module,
    params_of,
    scenes,
)

FORMS = {
    "saap": (from_name("saap", buckets=4, probes=2, capacity=KEYS), TEXT),
    "windowed": (from_name("windowed", window=1), TEXT),
    "windowed image": (from_name("windowed", window=1), IMAGE),
    "windowed whole image": (from_name("windowed", window=2, per_modality=False, alignment="diagonal_rev"), IMAGE),
    "windowed fa2": (from_name("windowed", window=1, alignment="fa2"), TEXT),
    "squeezed": (from_name("squeezed", clusters=3, capacity=KEYS), TEXT),
    "squeezed none": (from_name("squeezed", clusters=3, pool="none", capacity=KEYS), TEXT),
    "squeezed top": (from_name("squeezed", clusters=3, rule="top", keep=0.4), TEXT),
    "squeezed top none": (from_name("squeezed", clusters=3, rule="top", keep=0.4, pool="none"), TEXT),
}


@pytest.mark.parametrize("name", FORMS)
def test_gathering_is_masking(name):
    """Values, metrics, and the gradient by x and context; and something is left out."""
    options, spec = FORMS[name]
    x, x_mask, context, mask = scenes(spec)
    params = params_of(options, spec)

    def loss(x, context, form):
        y, aux = apply(dataclasses.replace(options, form=form), params, x, x_mask, context, mask, spec=spec)
        return jnp.sin(y).sum(), (y, aux.metrics)

    compiled = golden.jit(jax.value_and_grad(loss, (0, 1), has_aux=True), static_argnums=2)
    with jax.enable_x64(True):
        masked, gathered = (compiled(x, context, form) for form in ("mask", "gather"))
    jax.tree.map(close, gathered, masked)
    assert 0.1 < float(masked[0][1][1]["selected"]) < 0.95


def test_windows_of_flash_attention_may_be_empty():
    """Bottom-right alignment, six keys: query 0 of four sees keys 1 to 3, and of the padded 512 prompts' tail none."""
    options, (x, x_mask, context, mask) = FORMS["windowed fa2"][0], scenes()
    few = mask & (np.arange(KEYS) < 2)[None]
    with jax.enable_x64(True):
        y = jax.device_get(call(options, params_of(options), x, x_mask, context, few)[0])
    assert not np.any(y[0, 0]) and np.all(np.abs(y[0, 1:4]).max(-1) > 1e-3)  # centre of query 0: 0 + 2 - 4


def test_what_does_not_fit_a_bucket_is_counted():
    options = from_name("saap", buckets=4, probes=2, form="gather", capacity=1)
    x, x_mask, context, mask = scenes()
    aux = call(options, params_of(options), x, x_mask, context, mask)[1]
    assert aux.metrics["overflow"] > 0.1


@pytest.mark.parametrize("name", ["concat", "linear", "agent learned", "saap joint", "deformable image", "squeezed"])
def test_a_cache_is_reused(name):
    """Encoded once and read in three steps: the same as encoding at each, bit for bit; and batches of caches join."""
    options, spec = CASES[name]
    made, (x, x_mask, context, mask) = module(options, spec), scenes(spec)
    params, x, context = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, jnp.float32), (params_of(options, spec), x, context)
    )
    x_mask, mask = jnp.asarray(x_mask), jnp.asarray(mask)
    encode = golden.jit(lambda params, context, mask: made.apply(params, context, mask, method="encode"))
    attend = golden.jit(lambda params, x, cache: made.apply(params, x, x_mask, cache, method="attend")[0])
    cache = encode(params, context, mask)
    for step in range(3):
        np.testing.assert_array_equal(
            attend(params, x + step, cache), attend(params, x + step, encode(params, context, mask))
        )
    assert all(len(leaf) == 2 for leaf in jax.tree.leaves(cache))
    half = jax.tree.map(lambda leaf: leaf[:1], cache)
    joined = jax.tree.map(lambda a: jnp.concatenate([a, a]), half)
    y = attend(params, jnp.stack([x[0], x[0]]), joined)
    close(y[0], attend(params, x, cache)[0], 1e-6)


def test_the_losses_of_saap_train_classifier_and_centroids_alone():
    options = from_name("saap", mode="joint", buckets=4, probes=2)
    x, x_mask, context, mask = scenes()

    def loss(params, x, context):
        return apply(options, params, x, x_mask, context, mask)[1].loss

    with jax.enable_x64(True):
        params = params_of(options)
        value, (of_params, *others) = golden.jit(jax.value_and_grad(loss, (0, 1, 2)))(params, x, context)
    trained = {"router", "centroids"}
    assert np.isfinite(value)
    assert all(np.any(leaf) for name in trained for leaf in jax.tree.leaves(of_params[name]))
    rest = [leaf for name, leaf in of_params.items() if name not in trained]
    assert not any(np.any(leaf) for leaf in jax.tree.leaves([rest, others]))


def _directions(seed, scenes, tokens):
    """Tokens around four directions, and queries that each look like one of them."""
    rng = np.random.default_rng(seed)
    centres = 4 * np.linalg.qr(rng.normal(size=(WIDTH, 4)))[0].T
    return (centres[rng.integers(4, size=(scenes, tokens))] + 0.1 * rng.normal(size=(scenes, tokens, WIDTH))).astype(
        np.float32
    )


def test_fitting_saap_makes_it_sparse_and_right():
    options = from_name("saap", buckets=4, probes=1, router_width=16)
    made, context, x = module(options), _directions(0, 24, KEYS), _directions(0, 24, 5)
    params = jax.tree.map(np.float32, params_of(options)) | {"fitted": np.zeros(1, np.float32)}
    for name in ("q", "k"):  # queries look for keys like themselves
        params[name] = {"kernel": 3 * np.eye(WIDTH, dtype=np.float32), "bias": np.zeros(WIDTH, np.float32)}
    mask, x_mask = np.ones(context.shape[:2], bool), np.ones(x.shape[:2], bool)
    before, aux = call(options, params, x, x_mask, context, mask)
    assert aux.metrics["selected"] == 1
    fitted, losses = fit(made, params, x, x_mask, context, mask, jax.random.key(0), steps=150, learning_rate=0.02)
    assert np.mean(losses[-20:]) < 0.7 * np.mean(losses[:5])
    after, aux = call(options, fitted, x, x_mask, context, mask)
    random = {**params, "fitted": fitted["fitted"]}
    lost, by_chance = (np.linalg.norm(y - before) for y in (after, call(options, random, x, x_mask, context, mask)[0]))
    assert aux.metrics["selected"] < 0.5 and lost < 0.7 * by_chance, (aux.metrics, lost, by_chance)
    same = {name for name in params if name not in ("centroids", "router", "fitted")}
    assert all(jax.tree.all(jax.tree.map(np.array_equal, params[name], fitted[name])) for name in same)


def test_calibrating_squeezed_keeps_the_share():
    options = from_name("squeezed", clusters=4, keep=0.4, pool="none")
    made, params = module(options), {"cross": jax.tree.map(np.float32, params_of(options))}
    rng = np.random.default_rng(0)
    x, context = (rng.normal(size=(16, size, WIDTH)).astype(np.float32) for size in (6, 40))
    x_mask, mask = np.ones(x.shape[:2], bool), np.arange(40)[None] < rng.integers(20, 41, size=(16, 1))
    scores = key_scores(made, params["cross"], x, x_mask, context, mask)
    assert len(scores) == mask.sum() * 2 * 6
    threshold = threshold_of([scores, scores], options.keep)
    fitted = with_threshold(params, threshold)
    share = call(options, fitted["cross"], x, x_mask, context, mask)[1].metrics["selected"]
    assert abs(share - options.keep) < 0.08, share


def test_kmeans_finds_directions_whatever_the_padding():
    points = _directions(1, 3, 20)[:, None]
    mask = np.arange(20)[None] < np.array([[20], [12], [0]])
    spoilt = np.where(mask[:, None, :, None], points, 1e3)
    centres = kmeans(jnp.asarray(spoilt), jnp.asarray(mask), 4, 5)
    similarity = np.einsum("bhmd,bhcd->bhmc", points, centres) / np.linalg.norm(points, axis=-1)[..., None]
    assert similarity.max(-1)[:2][mask[:2, None]].min() > 0.99
    again = kmeans(jnp.asarray(points[:, :, ::-1]), jnp.asarray(mask[:, ::-1]), 4, 5)
    close(
        nearest(jnp.asarray(points), again), nearest(jnp.asarray(points), centres)
    )  # the order does not matter either


def test_names_and_options():
    for name, kind in OPTIONS.items():
        assert from_name(**to_config(from_name(name))) == kind() and hash(kind()) == hash(from_name(name))
    with pytest.raises(ValueError, match=r"did you mean 'windowed'\? choose one of none, concat, full"):
        from_name("windowd")
    with pytest.raises(ValueError, match="windowed has no option width: it has window, alignment"):
        from_name("windowed", width=3)
    for name, fields, message in (
        ("windowed", {"window": -1}, "at least 0"),
        ("saap", {"probes": 33}, "probes is 33"), ("squeezed", {"keep": 0.0}, "share of the keys"),
        ("full", {"inner_ratio": 0}, "inner_ratio"), ("full", {"chunk": True}, "integer"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            from_name(name, **fields)
    with pytest.raises(ValueError, match=r"CrossGlobalOptions.style must be one of 'a', 'b', not 'code'"):
        one_of(CrossGlobalOptions(), style=("a", "b"))
    with pytest.raises(ValueError, match="image's grid"):
        build(from_name("agent", grid_bias=True), 8, 2, TEXT, init=ParamInit())
    with pytest.raises(ValueError, match="multiple of heads"):
        build(from_name("full"), 9, 2, TEXT, init=ParamInit())
    for fields in ({"kind": "image"}, {"grid": (2, 2)}, {"modalities": 2}):
        with pytest.raises(ValueError, match="ContextLayout"):
            ContextSpec(**fields)


@pytest.mark.parametrize(
    ("name", "fields", "parameters"),
    [
        ("concat", {}, lambda d: 4 * d * d + 8 * d + d),
        ("full", {}, lambda d: 4 * d * d + 8 * d),
        ("gated", {}, lambda d: 4 * d * d + 8 * d + 1),
        ("linear", {}, lambda d: 4 * d * d + 5 * d),
        ("agent", {}, lambda d: 4 * d * d + 8 * d),
        ("windowed", {}, lambda d: 4 * d * d + 8 * d),
        ("squeezed", {}, lambda d: 4 * d * d + 8 * d + 1),
        ("saap", {}, lambda d: 4 * d * d + 8 * d + 8 * (d // 8 * 64 + 64 + 64 * 32 + 32 + 32 * d // 8) + 1),
        ("deformable", {}, lambda d: 2 * d * d + 2 * d + (d + 1) * (2 + 3 * 8 * 2 * 4)),
        ("cross_global", {}, lambda d: 8 * d * d + 50 * d + 1),
        ("cross_global", {"style": "paper"}, lambda d: 6 * d * d + 44 * d + 1),
    ],
)
def test_parameter_counts(name, fields, parameters):
    """The closed forms of the specification, at 8 heads and two 14 x 14 grids."""
    made = module(from_name(name, **fields), ContextSpec(kind="image", grid=(14, 14), modalities=2), 64, 8)
    assert count(jax.eval_shape(made.init, jax.random.key(0))) == parameters(64)


def test_full_attention_at_the_parameters_of_cross_global():
    sizes = [
        count(jax.eval_shape(module(from_name(name, **fields), TEXT, 512, 8).init, jax.random.key(0)))
        for name, fields in (("full", {"inner_ratio": 2}), ("cross_global", {}))
    ]
    assert sizes[1] == 2_122_753 and abs(sizes[0] / sizes[1] - 1) < 0.01
