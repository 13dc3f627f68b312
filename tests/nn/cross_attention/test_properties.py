"""The contract of every mechanism, and for each symmetry whether it holds or, by design, does not (§2, §9)."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from tests.factories.attention_cases import CASES, KEYS, QUERIES, close, evaluate, moved, params_of, scattered, scenes

_WINDOWED = {case for case in CASES if case.startswith("windowed")}
_PLACED = {"linear dwc", "agent bias", "deformable text", "deformable image"}  # a key's place in its row matters
ORDERED_QUERIES = {"agent segment", "agent bias", *_WINDOWED}
DEPENDENT_QUERIES = {"concat", "agent segment", "agent set", "agent bias", "squeezed", *_WINDOWED}
ORDERED_KEYS = _WINDOWED | _PLACED | {"squeezed top"}  # members of a cluster are equal: the first are kept


@pytest.mark.parametrize("case", CASES)
def test_masked_values_never_matter(case):
    """Masked rows at random places, of NaN, of 1e30 and of numbers: values and gradients stay, to rounding."""
    spec = CASES[case][1]
    x, x_mask, context, mask = scenes(spec)
    (loss, y, aux), (of_params, of_x, of_context) = evaluate(case, x, x_mask, context, mask)
    assert not np.any(y[~x_mask]) and not np.any(of_x[~x_mask]) and not np.any(of_context[~mask])
    assert np.abs(of_x).max() > 1e-3 and np.abs(of_context).max() > 1e-3
    for seed, fill in enumerate((np.nan, 1e30, 0.7)):
        new_x = scattered(x_mask, 1, seed)
        new = mask if case in _PLACED else scattered(mask, spec.modalities, seed)
        spoilt = moved(x, x_mask, new_x, fill), new_x, moved(context, mask, new, fill), new
        (loss_2, y_2, aux_2), (of_params_2, of_x_2, of_context_2) = evaluate(case, *spoilt)
        close(loss_2, loss)
        close(y_2, moved(y, x_mask, new_x, 0))
        close(of_x_2, moved(of_x, x_mask, new_x, 0))
        close(of_context_2, moved(of_context, mask, new, 0))
        jax.tree.map(close, of_params_2, of_params)
        jax.tree.map(close, aux_2, aux)


@pytest.mark.parametrize("case", CASES)
def test_permuted_queries(case):
    """y moves with x, or does not."""
    x, x_mask, context, mask = scenes(CASES[case][1])
    y = evaluate(case, x, x_mask, context, mask)[0][1]
    order = np.array([2, 0, 3, 1, 4, 5])  # of the four valid queries of both scenes
    permuted = evaluate(case, x[:, order], x_mask[:, order], context, mask)[0][1]
    _holds(permuted, y[:, order], case not in ORDERED_QUERIES)


@pytest.mark.parametrize("case", CASES)
def test_changed_other_queries(case):
    """What query 1 reads, when the others change and one of them goes."""
    x, x_mask, context, mask = scenes(CASES[case][1])
    y = evaluate(case, x, x_mask, context, mask)[0][1]
    fewer = x_mask & (x_mask[:, ::-1].argmax(1)[:, None] != np.arange(QUERIES)[None, ::-1])
    changes = []
    for seed in range(4):
        other = np.random.default_rng(seed).normal(size=x.shape) * (np.arange(QUERIES) != 1)[None, :, None]
        changed = np.where(np.arange(QUERIES)[None, :, None] == 1, x, other)
        changes.append(evaluate(case, changed, fewer, context, mask)[0][1][:, 1])
    _holds(np.stack(changes), np.stack([y[:, 1]] * 4), case not in DEPENDENT_QUERIES)


@pytest.mark.parametrize("case", CASES)
def test_permuted_keys(case):
    spec = CASES[case][1]
    x, x_mask, context, mask = scenes(spec)
    order = np.array([3, 1, 0, 2, 4, 5, 6, 7]) if spec.modalities == 1 else np.array([1, 0, 2, 3, 5, 4, 6, 7])
    y, permuted = (
        evaluate(case, x, x_mask, c, k)[0][1] for c, k in ((context, mask), (context[:, order], mask[:, order]))
    )
    _holds(permuted, y, case not in ORDERED_KEYS)


@pytest.mark.parametrize("case", CASES)
def test_empty_contexts_give_zero(case):
    """Zero with zero gradients, except for concat, whose tokens read each other; finite in every other corner."""
    spec = CASES[case][1]
    x, x_mask, context, mask = scenes(spec)
    context = np.where(mask[..., None], context, np.nan)
    (_, y, _), gradients = evaluate(case, x, x_mask, np.full_like(context, np.nan), mask & False)
    if CASES[case][0].empty_is_zero:
        assert not any(np.any(leaf) for leaf in [y, *jax.tree.leaves(gradients)])
    else:
        assert np.any(y[x_mask]) and not np.any(gradients[2])
    one = np.zeros_like(mask)
    one[:, :: KEYS // spec.modalities] = True  # a key a modality
    corners = {
        "all keys masked": (x_mask, mask & False),
        "all queries masked": (x_mask & False, mask),
        "one query": (x_mask & (np.arange(QUERIES) == 2)[None], mask),
        "one key": (x_mask, one),
        "one scene empty": (x_mask, mask & [[True], [False]]),
    }
    for corner, (rows, keys) in corners.items():
        result = evaluate(case, np.where(rows[..., None], x, np.nan), rows, context, keys)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(result)), corner
        (_, y, _), (_, of_x, of_context) = result
        assert not np.any(y[~rows]) and not np.any(of_x[~rows]) and not np.any(of_context[~keys]), corner


@pytest.mark.parametrize("case", CASES)
def test_gradients_match_central_differences(case):
    """Along a random direction in parameters, x and context, by central differences."""
    spec = CASES[case][1]
    x, x_mask, context, mask = scenes(spec)
    params = params_of(*CASES[case])
    _, gradients = evaluate(case, x, x_mask, context, mask)
    rng, step = np.random.default_rng(3), 1e-6
    point = (params, x, context)
    along = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape), point)
    statistics = {"fitted", "threshold", "centroids", "router"} & params.keys()  # these choose keys, without gradient
    along[0].update({name: jax.tree.map(np.zeros_like, params[name]) for name in statistics})
    moved_by = [jax.tree.map(lambda p, v, s=s: p + s * step * v, point, along) for s in (1, -1)]
    up, down = (evaluate(case, x, x_mask, context, mask, params)[0][0] for params, x, context in moved_by)
    slope = sum((g * v).sum() for g, v in zip(jax.tree.leaves(gradients), jax.tree.leaves(along), strict=True))
    np.testing.assert_allclose((up - down) / (2 * step), slope, rtol=1e-6, atol=1e-7)
    for name in statistics:
        assert not any(np.any(leaf) for leaf in jax.tree.leaves(gradients[0][name])), name


@pytest.mark.parametrize("case", CASES)
def test_scenes_of_a_batch_are_independent(case):
    """Each scene of a batch as in a batch of two of itself (official-spec: the release returns rows out of order)."""
    batch = scenes(CASES[case][1])
    y = evaluate(case, *batch)[0][1]
    for scene in range(2):
        twice = evaluate(case, *(np.stack([part[scene]] * 2) for part in batch))[0][1]
        close(twice[0], y[scene])
        # Float64 rounding only: XLA may compute the rows of one array by vectors and a scalar rest.
        np.testing.assert_allclose(twice[0], twice[1], rtol=0, atol=1e-14)


_ALIKE = {"full", "agent segment", "agent learned", "agent set", "saap", "windowed", "windowed image", "squeezed"}


@pytest.mark.parametrize("case", sorted({*_ALIKE, "cross_global", "full memory"}))
def test_context_of_zeros_gives_a_constant(case):
    """The official null condition (``attend_padding``): every query reads the same, but for learned tokens."""
    x, x_mask, context, mask = scenes(CASES[case][1])
    y = evaluate(case, x, x_mask, 0 * context, mask | True)[0][1]
    spread = np.abs(y[0, :4] - y[0, :1]).max()
    assert spread < 1e-12 if case in _ALIKE else spread > 1e-3, spread


def _holds(a, b, expected: bool):
    difference = np.abs(a - b).max()
    assert difference < 1e-10 if expected else difference > 1e-3, difference
