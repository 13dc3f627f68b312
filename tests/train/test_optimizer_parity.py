"""AdamW, clipping, rates and the moving average against the official training loop."""

from __future__ import annotations

import json

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from scjax.train.ema import update_ema
from scjax.train.optimizer import adamw, is_decayed, learning_rates
from tests.factories import golden

TOLERANCE = 1e-6


def _tree(data, prefix, decays):
    """Official keys as a tree whose decayed leaves are named as ours are."""
    keys = [key.removeprefix(prefix) for key in data if key.startswith(prefix)]
    return {key: {"kernel" if decays[key] else "other": jnp.asarray(data[prefix + key])} for key in keys}


@pytest.fixture(scope="module")
def vectors(parity_dir):
    path = parity_dir / "optimiser_decay.json"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    decays = json.loads(path.read_text())
    return golden.load(parity_dir, "optimiser_inputs.npz"), golden.load(parity_dir, "optimiser_outputs.npz"), decays


def test_optimiser_parity(vectors):
    inputs, outputs, decays = vectors
    params = _tree(inputs, "param/", decays)
    optimizer = adamw(learning_rate=0.01, steps=10, warmup=2, schedule="linear", weight_decay=0.1)
    rate = learning_rates(0.01, steps=10, warmup=2, schedule="linear")
    shadows, state = {0.9999: params, 0.3: params}, optimizer.init(params)
    update = jax.jit(optimizer.update)
    for k in range(5):
        gradients = _tree(inputs, f"grad{k}/", decays)
        np.testing.assert_allclose(
            optax.tree.norm(gradients), outputs[f"step{k}/grad_norm_before_clip"], rtol=TOLERANCE
        )
        np.testing.assert_allclose(rate(k), outputs[f"step{k}/lr"], rtol=TOLERANCE)
        updates, state = update(gradients, state, params)
        params = optax.apply_updates(params, updates)
        results = {"param": params}
        for decay in shadows:
            results[f"ema{decay}"] = shadows[decay] = update_ema(shadows[decay], params, k + 1, decay)
        for name, tree in results.items():
            expected = _tree(outputs, f"step{k}/{name}/", decays)
            assert expected.keys() == tree.keys()
            for key, leaf in tree.items():
                value, reference = (np.asarray(next(iter(x.values()))) for x in (leaf, expected[key]))
                scale = np.abs(reference).max()
                np.testing.assert_allclose(
                    value, reference, rtol=TOLERANCE, atol=TOLERANCE * scale, err_msg=f"step {k} {name} {key}"
                )


def test_learning_rates_parity(vectors):
    _, outputs, _ = vectors
    linear = learning_rates(1.0, steps=357_450, warmup=1000, schedule="linear")
    constant = learning_rates(1.0, steps=1, warmup=500, schedule="constant")
    for i, step in enumerate(outputs["lr_factor/steps"]):
        np.testing.assert_allclose(linear(int(step)), outputs["lr_factor/linear_autoencoder"][i], rtol=TOLERANCE)
        np.testing.assert_allclose(constant(int(step)), outputs["lr_factor/constant_diffusion"][i], rtol=TOLERANCE)


def test_decay_acts_on_kernels_only():
    params = {"a": {"kernel": jnp.ones((2, 2)), "bias": jnp.ones(2)}, "blocks": {0: {"scale": jnp.ones(2)}}}
    assert is_decayed(params) == {"a": {"kernel": True, "bias": False}, "blocks": {0: {"scale": False}}}


def test_a_schedule_shorter_than_its_warmup_is_refused():
    with pytest.raises(ValueError, match="warm-up"):
        learning_rates(1.0, steps=10, warmup=10, schedule="linear")
