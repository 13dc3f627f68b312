"""Calibration of a trained reader: the shares that it gives become how often such answers are right.

Logits are divided by a temperature, one for named values and one for the ends of ranges (Guo et al. 2017), at which the
labels of texts that were not trained on are most likely. What is read does not change. The temperatures go into the
weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import optax

from scjax.language.reader.targets import Targets, is_set, value_mask
from scjax.models.reader_network import ReaderOutputs
from scjax.nn.functional import Params

_TEMPERATURES = np.geomspace(0.5, 5.0, 47)
_WEIGHTS = {"named": ("named", "named_bias"), "ends": ("ends", "end_bias")}  # output -> parameters linear in it


def reader_losses(outputs: ReaderOutputs, named: jax.Array, ends: jax.Array) -> ReaderOutputs:
    """Sums of the cross-entropies of each text [B]: of the attributes with named values, and of the ends of ranges."""
    allowed, sets = value_mask()[None], is_set()
    logits = jnp.where(allowed, outputs.named, -1e9)
    one = optax.softmax_cross_entropy(logits[:, ~sets], named[:, ~sets])
    some = jnp.where(allowed[:, sets], optax.sigmoid_binary_cross_entropy(outputs.named[:, sets], named[:, sets]), 0.0)
    bounds = optax.softmax_cross_entropy_with_integer_labels(outputs.ends, ends)
    return ReaderOutputs(named=one.sum(1) + some.sum((1, 2)), ends=bounds.sum((1, 2)))


def calibrate(params: Params, logits: ReaderOutputs, targets: Sequence[Targets]) -> Params:
    """The parameters whose outputs are calibrated.

    Args:
      logits, targets: of texts that were not trained on.
    """
    named, ends = (np.stack([one[part] for one in targets]) for part in range(2))

    @jax.jit
    def mean_losses(scale: jax.Array) -> ReaderOutputs:
        losses = reader_losses(jax.tree.map(lambda x: x * scale, logits), named, ends)
        return jax.tree.map(jnp.mean, losses)

    of_temperature = [mean_losses(np.float32(1 / temperature)) for temperature in _TEMPERATURES]
    calibrated = dict(params)
    for part, names in _WEIGHTS.items():
        best = _TEMPERATURES[int(np.argmin([getattr(one, part) for one in of_temperature]))]
        calibrated |= {name: jnp.asarray(params[name]) / np.float32(best) for name in names}
    return calibrated
