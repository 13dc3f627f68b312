"""Calibration of the reader: likelier shares, the same readings."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from experiments.reader_calibration import calibrate, reader_losses
from scjax.generate.prompt_reader import reader_config
from scjax.language.reader.targets import read_outputs, request_targets
from scjax.models.reader_network import reader_network

TRUE, STATED = {"layout": "T", "vehicles": (2, 2)}, {"layout": "roundabout", "pedestrians": (1, None)}


def test_overconfident_shares_become_lower_and_labels_likelier():
    """Weights that are sure of one request, where three texts of four make it."""
    config = reader_config(8, width=8)
    network = reader_network(config)
    params = dict(jax.tree.map(jnp.zeros_like, network.init(jax.random.key(0))))
    sure, targets = request_targets(TRUE), [request_targets(one) for one in (TRUE, TRUE, TRUE, STATED)]
    params["named_bias"] = 30.0 * jnp.asarray(sure.named) - 15.0
    params["end_bias"] = 15.0 * jax.nn.one_hot(sure.ends, config.levels)
    features, numbers, mask = np.zeros((1, 32, 8), np.float16), np.zeros((1, 32), np.int32), np.ones((1, 32), bool)
    apply = jax.jit(network.apply)
    outputs = [apply(params, features, numbers, mask)] * 4
    calibrated = calibrate(params, jax.tree.map(lambda *x: np.concatenate(x), *outputs), targets)
    after = apply(calibrated, features, numbers, mask)

    def read(one):
        return read_outputs(np.asarray(one.named[0]), np.asarray(one.ends[0]))

    before, now = read(outputs[0]), read(after)
    assert before.request == now.request == TRUE
    assert all(now.shares[name] < before.shares[name] - 0.001 for name in TRUE)
    named, ends = (np.stack([one[part] for one in targets]) for part in range(2))
    four = (
        jax.tree.map(lambda *x: jnp.concatenate(x), *[after] * 4),
        jax.tree.map(lambda *x: jnp.concatenate(x), *outputs),
    )
    better, worse = (reader_losses(one, named, ends) for one in four)
    assert better.named.mean() < worse.named.mean() and better.ends.mean() < worse.ends.mean()
