"""The encoder of the reader, for many texts: one compiled layer in a loop, and products of bfloat16 operands.

The operands are rounded where the processor multiplies bfloat16 faster; features differ from those of
``FrozenTextEncoder`` by less than a hundredth of their size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.encoders.bert import BertConfig
from scjax.encoders.text import FrozenTextEncoder
from scjax.nn.attention import attend
from scjax.nn.cpu.precision import matmul
from scjax.nn.functional import Params
from scjax.nn.layers import standardize

_GROUP = 32  # texts in a call
_STEP = 32  # tokens are padded to a multiple of so many


def token_features(encoder: FrozenTextEncoder, ids: Sequence[np.ndarray]) -> Iterator[tuple[int, np.ndarray]]:
    """(number of the text, float16 features [tokens, width]) of texts as token ids, short texts first."""
    weights = stacked_weights(encoder)
    program = jax.jit(lambda *inputs: encode_tokens(encoder.config, *inputs).astype(jnp.float16))
    order = sorted(range(len(ids)), key=lambda row: len(ids[row]))
    for start in range(0, len(order), _GROUP):
        part = order[start : start + _GROUP]
        length = min(-(-len(ids[part[-1]]) // _STEP) * _STEP, encoder.config.max_tokens)
        padded, mask = np.zeros((_GROUP, length), np.int32), np.zeros((_GROUP, length), bool)
        for place, row in enumerate(part):
            padded[place, : len(ids[row])], mask[place, : len(ids[row])] = ids[row], True
        features = np.asarray(program(weights, padded, mask))
        yield from ((row, features[place, : len(ids[row])]) for place, row in enumerate(part))


def stacked_weights(encoder: FrozenTextEncoder) -> dict[str, Params]:
    """The encoder's weights; those of all its layers under "layers", stacked."""
    layers = encoder.params["layers"]
    stacked = jax.tree.map(lambda *arrays: jnp.stack(arrays), *(layers[number] for number in range(len(layers))))
    return {**jax.tree.map(jnp.asarray, {**encoder.params, "layers": {}}), "layers": stacked}


def encode_tokens(
    config: BertConfig, weights: Mapping[str, Any], ids: Int[Array, "b n"], mask: Bool[Array, "b n"]
) -> Float[Array, "b n d"]:
    """Token features.

    Args:
      weights: as ``stacked_weights`` gives them.
    """

    def norm(own: Params, x: Array) -> Array:
        return standardize(x, config.layer_norm_eps) * own["scale"][None, None] + own["bias"][None, None]

    def layer(x: Array, own: Any) -> tuple[Array, None]:
        parts = (_linear(own[name], x) for name in ("query", "key", "value"))
        attended = attend(*parts, mask[:, None], config.num_attention_heads)
        x = norm(own["norm"], x + _linear(own["out"], attended))
        inner = jax.nn.gelu(_linear(own["up"], x), approximate=False)
        return norm(own["out_norm"], x + _linear(own["down"], inner)), None

    x = weights["words"][ids] + weights["positions"][None, : ids.shape[1]] + weights["segments"][:1][None]
    x, _ = jax.lax.scan(layer, norm(weights["norm"], x), weights["layers"])
    return x


def _linear(own: Params, x: Float[Array, "b n i"]) -> Float[Array, "b n o"]:
    y = matmul(x.reshape(-1, x.shape[-1]), own["kernel"], "auto") + own["bias"][None]
    return y.reshape(*x.shape[:-1], -1)
