"""Where a mechanism must equal full attention with the same projections, or has a value that is known (§9)."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cross_attention import ContextSpec, from_name
from scjax.nn.cross_attention.deformable import sample_values
from scjax.nn.cross_attention.squeezed import cluster, cluster_shares
from tests.factories import golden
from tests.factories.attention_cases import HEADS, IMAGE, KEYS, QUERIES, TEXT, WIDTH, call, close, params_of, scenes

FULL = from_name("full")
_EVERYTHING = max(QUERIES, KEYS)
LIMITS = {
    "chunked": (from_name("full", chunk=3), {}),
    "gated": (from_name("gated"), {}),
    "saap": (from_name("saap", buckets=4, probes=4), {}),
    "saap before it is fitted": (from_name("saap", buckets=4, probes=1), {"fitted": np.zeros(1)}),
    **{
        f"windowed {a}": (from_name("windowed", window=_EVERYTHING, alignment=a), {})
        for a in ("diagonal", "diagonal_rev", "fa2")
    },
    "windowed as one": (from_name("windowed", window=_EVERYTHING, per_modality=False), {}),
    "squeezed": (from_name("squeezed", clusters=KEYS, rule="top", keep=1.0), {}),
    "squeezed before it is fitted": (from_name("squeezed", clusters=2), {"threshold": np.full(1, -1.0)}),
    "cross_global": (from_name("cross_global"), {"gate": np.zeros(1)}),
    "cross_global paper": (from_name("cross_global", style="paper"), {"gate": np.zeros(1)}),
}
_ROUNDED = ("chunked", "saap", "windowed diagonal", "squeezed", "cross_global")


@pytest.mark.parametrize(
    ("limit", "x64", "tolerance"),
    [*((limit, True, 1e-10) for limit in LIMITS), *((limit, False, 1e-5) for limit in _ROUNDED)],
)
def test_limit_equals_full_attention(limit, x64, tolerance):
    """Shared parameters have the same names, so parameters of full attention load into every mechanism."""
    options, known = LIMITS[limit]
    with jax.enable_x64(x64):
        batch, shared = _cast(scenes(IMAGE), x64), params_of(FULL)
        params = _cast({**params_of(options, IMAGE), **shared, **known}, x64)
        y, _ = call(options, params, *batch, spec=IMAGE)
        expected, _ = call(FULL, _cast(shared, x64), *batch, spec=IMAGE)
        close(y, expected * np.tanh(params["gate"][0]) if limit == "gated" else expected, tolerance)


def _cast(tree, x64: bool):
    dtype = np.float64 if x64 else np.float32
    return jax.tree.map(lambda leaf: leaf if leaf.dtype == bool else np.asarray(leaf, dtype), tree)


def _in64(*arguments, **options):
    with jax.enable_x64(True):
        return jax.device_get(call(*arguments, **options)[0])


def test_concat_is_full_attention_to_scene_and_context():
    options, (x, x_mask, context, mask) = from_name("concat"), scenes()
    params = {**params_of(options), "kind": np.zeros(WIDTH)}
    shared = {name: leaf for name, leaf in params.items() if name != "kind"}
    both, both_mask = np.concatenate([x, context], 1), np.concatenate([x_mask, mask], 1)
    close(_in64(options, params, x, x_mask, context, mask), _in64(FULL, shared, x, x_mask, both, both_mask))


def test_memory_tokens_extend_the_context():
    options, (x, x_mask, context, mask) = from_name("full", memory_tokens=2), scenes()
    params = params_of(options)
    more = np.concatenate([context, np.stack([params["memory"]] * 2)], 1)
    more_mask = np.concatenate([mask, np.ones((2, 2), bool)], 1)
    shared = {name: leaf for name, leaf in params.items() if name != "memory"}
    close(_in64(options, params, x, x_mask, context, mask), _in64(FULL, shared, x, x_mask, more, more_mask))


@pytest.mark.parametrize(("sharpness", "error"), [(1.0, None), (1e3, 1e-10)])
def test_one_agent_per_query_is_full_attention(sharpness, error):
    """n agents from n queries are the queries; as stage 2 sharpens, each query reads its own agent.

    One head, so that the norms give all queries one length. Larger queries sharpen both stages; smaller keys undo it
    in the first.
    """
    options, (x, x_mask, context, mask) = from_name("agent", tokens=4), (part[:1] for part in scenes())
    params = params_of(options, heads=1)
    params = {**params, "q_norm": {"scale": np.full(WIDTH, sharpness), "bias": np.zeros(WIDTH)}}
    params["k_norm"] = {"scale": params["k_norm"]["scale"] / sharpness, "bias": np.zeros(WIDTH)}
    y, expected = (_in64(o, params, x, x_mask, context, mask, heads=1) for o in (options, FULL))
    if error is None:
        assert np.abs(y - expected).max() > 1e-2
    else:
        close(y, expected, error)


def test_single_agent_gives_all_queries_the_same():
    x, x_mask, context, mask = scenes()
    for pooling in ("segment", "learned", "set"):
        options = from_name("agent", tokens=1, pooling=pooling)
        y = _in64(options, params_of(options), x, x_mask, context, mask)
        close(y[0, :4], np.broadcast_to(y[0, :1], (4, WIDTH)))


SOFTMAX = {
    "full": FULL,
    "wide": from_name("full", inner_ratio=2),
    "gated": from_name("gated"),
    "agent": from_name("agent", tokens=2),
    "saap": from_name("saap", buckets=2, probes=1),
    "windowed": from_name("windowed", window=1),
    "squeezed": from_name("squeezed", clusters=2),
}


@pytest.mark.parametrize("name", SOFTMAX)
def test_constant_values_pass_through(name):
    """Weights sum to one: if all values are b, y = W_o b + b_o; one readable key is such a case."""
    options, (x, x_mask, context, mask) = SOFTMAX[name], scenes()
    params = params_of(options)
    constant = {**params, "v": {**params["v"], "kernel": 0 * params["v"]["kernel"]}}
    expected = params["v"]["bias"] @ params["out"]["kernel"] + params["out"]["bias"]
    single = mask & (np.arange(KEYS) == 1)[None]
    value = context[:, 1] @ params["v"]["kernel"] + params["v"]["bias"]
    result = value @ params["out"]["kernel"] + params["out"]["bias"]
    if name == "gated":
        expected, result = (np.tanh(params["gate"]) * a for a in (expected, result))
    close(_in64(options, constant, x, x_mask, context, mask)[x_mask], np.broadcast_to(expected, (x_mask.sum(), WIDTH)))
    y = _in64(options, params, x, x_mask, context, single)
    for scene in range(2):
        close(y[scene][x_mask[scene]], np.broadcast_to(result[scene], (x_mask[scene].sum(), WIDTH)))


@functools.partial(golden.jit, static_argnums=5)
def _sampled(value, mask, position, weights, level, spec):
    return sample_values(value, mask, position, weights, level, spec)


def test_deformable_samples_cell_centres():
    """Sampled at all cell centres, each returns its own value; far outside there is nothing."""
    rng = np.random.default_rng(0)
    spec = ContextSpec(kind="image", grid=(2, 3))
    value, logits = rng.normal(size=(1, HEADS, 6, 4)), rng.normal(size=(1, 5, HEADS, 6))
    weights = np.exp(logits) / np.exp(logits).sum(-1, keepdims=True)
    row, column = np.divmod(np.arange(6.0), 3)
    position = np.broadcast_to(np.stack([column, row], -1), (1, 5, HEADS, 6, 2))
    mask, level = np.ones((1, 6), bool), np.zeros(6, int)
    one = np.broadcast_to(np.arange(6) == 4, weights.shape).astype(float)
    with jax.enable_x64(True):
        close(_sampled(value, mask, position, weights, level, spec), np.einsum("bnhk,bhkd->bhnd", weights, value))
        own = _sampled(value, mask, position, one, level, spec)
        close(own, np.broadcast_to(value[:, :, 4:5], (1, HEADS, 5, 4)))
        assert not np.any(_sampled(value, mask, position + 100, weights, level, spec))


def test_deformable_text_is_interpolated_linearly():
    """Inside the readable tokens like numpy's interp; what lies a token beyond the ends is zero."""
    rng = np.random.default_rng(0)
    value, mask = rng.normal(size=(1, 1, 7, 1)), np.arange(7)[None] < 5
    value[:, :, 5:] = 0
    position = np.array([0.0, 0.25, 3.5, 4.0, -0.5, 4.5, -1.0, 5.0, 9.0])
    expected = np.interp(position, np.arange(5), value[0, 0, :5, 0])
    expected[4:6] = value[0, 0, [0, 4], 0] / 2
    expected[6:] = 0
    with jax.enable_x64(True):
        places = position[None, :, None, None, None]
        got = _sampled(value, mask, places, np.ones((1, 9, 1, 1)), np.zeros(1, int), TEXT)
    close(got[0, 0, :, 0], expected)


def test_cluster_shares_sum_to_one():
    rng = np.random.default_rng(0)
    keys, mask = rng.normal(size=(2, HEADS, KEYS, 4)), scenes()[3]

    @golden.jit
    def run(keys, mask, query):
        clusters = cluster(keys, mask, 3, 4)
        return cluster_shares(query, clusters), clusters.size

    query = 30 * rng.normal(size=(2, HEADS, 5, 4))
    shares, sizes = jax.device_get(run(np.float32(keys), mask, np.float32(query)))
    close((shares * sizes[:, :, None]).sum(-1), np.ones((2, HEADS, 5)), 1e-5)
    assert sizes.sum(-1).tolist() == [[6, 6], [4, 4]]


@pytest.mark.parametrize("name", ["concat", "agent", "linear", "deformable", "cross_global"])
def test_bfloat16_products(name):
    options, batch = from_name(name), _cast(scenes(), False)
    params = _cast(params_of(options), False)
    exact, rounded = (call(options, params, *batch, compute=compute)[0] for compute in ("float32", "bfloat16"))
    assert rounded.dtype == jnp.float32
    error = np.linalg.norm(rounded - exact) / np.linalg.norm(exact)
    assert 0 < error < 2e-2, error
