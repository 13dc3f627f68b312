"""Calibration of the sparse mechanisms on trained parameters."""

from __future__ import annotations

import jax
import numpy as np

from scjax.nn.cross_attention import from_name
from scjax.nn.cross_attention.calibrate import fit_saap, key_scores, score_threshold, with_threshold
from tests.factories.attention_cases import KEYS, WIDTH, call, clustered_tokens, module, params_of


def test_fit_saap_is_sparse_and_beats_random_buckets():
    options = from_name("saap", buckets=4, probes=1, router_width=16)
    network, context, x = module(options), clustered_tokens(0, 24, KEYS), clustered_tokens(0, 24, 5)
    params = jax.tree.map(np.float32, params_of(options)) | {"fitted": np.zeros(1, np.float32)}
    for name in ("q", "k"):  # queries look for keys like themselves
        params[name] = {"kernel": 3 * np.eye(WIDTH, dtype=np.float32), "bias": np.zeros(WIDTH, np.float32)}
    mask, x_mask = np.ones(context.shape[:2], bool), np.ones(x.shape[:2], bool)
    before, aux = call(options, params, x, x_mask, context, mask)
    assert aux.metrics["selected"] == 1
    fitted, losses = fit_saap(
        network, params, x, x_mask, context, mask, jax.random.key(0), steps=150, learning_rate=0.02
    )
    assert np.mean(losses[-20:]) < 0.7 * np.mean(losses[:5])
    after, aux = call(options, fitted, x, x_mask, context, mask)
    random_params = {**params, "fitted": fitted["fitted"]}
    error, random_error = (
        np.linalg.norm(y - before) for y in (after, call(options, random_params, x, x_mask, context, mask)[0])
    )
    assert aux.metrics["selected"] < 0.5 and error < 0.7 * random_error, (aux.metrics, error, random_error)
    same = {name for name in params if name not in ("centroids", "router", "fitted")}
    assert all(jax.tree.all(jax.tree.map(np.array_equal, params[name], fitted[name])) for name in same)


def test_squeezed_threshold_keeps_the_share():
    options = from_name("squeezed", clusters=4, keep=0.4, pool="none")
    network, params = module(options), {"cross": jax.tree.map(np.float32, params_of(options))}
    rng = np.random.default_rng(0)
    x, context = (rng.normal(size=(16, size, WIDTH)).astype(np.float32) for size in (6, 40))
    x_mask, mask = np.ones(x.shape[:2], bool), np.arange(40)[None] < rng.integers(20, 41, size=(16, 1))
    scores = key_scores(network, params["cross"], x, x_mask, context, mask)
    assert len(scores) == mask.sum() * 2 * 6
    threshold = score_threshold([scores, scores], options.keep)
    fitted = with_threshold(params, threshold)
    share = call(options, fitted["cross"], x, x_mask, context, mask)[1].metrics["selected"]
    assert abs(share - options.keep) < 0.08, share
