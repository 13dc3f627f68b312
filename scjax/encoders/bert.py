"""BERT (Devlin et al. 2019) as a frozen text encoder: post-norm, exact GELU, absolute positions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from scjax.encoders.base import CONFIG_CURE, CONFIG_FILE, Epsilon, Layers, PublishedNetwork, Rows, Size
from scjax.nn.attention import attend
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear
from scjax.nn.state_dict import SAME, TRANSPOSE, Rules
from scjax.scene.document import convert_document

_STD = 0.02
_UNUSED = ("embeddings.position_ids", "pooler.dense.weight", "pooler.dense.bias")  # keys that tokens do not need


@dataclasses.dataclass(frozen=True, kw_only=True)
class BertConfig:
    """Sizes, named as in ``config.json`` of the transformers library."""

    vocab_size: Rows = 30522
    hidden_size: Size = 384
    num_hidden_layers: Layers = 6
    num_attention_heads: Size = 12
    intermediate_size: Size = 1536
    max_position_embeddings: Size = 512
    type_vocab_size: Size = 2
    layer_norm_eps: Epsilon = 1e-12

    def __post_init__(self):
        if self.hidden_size % self.num_attention_heads:
            raise ValueError(
                f"hidden_size {self.hidden_size} is no multiple of num_attention_heads {self.num_attention_heads}"
            )

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> BertConfig:
        """Sizes from the content of a ``config.json``.

        Raises:
          ValueError: a field of another type or out of its range, or a variant of BERT that this network is not.
        """
        for name, supported in (("hidden_act", "gelu"), ("position_embedding_type", "absolute")):
            if content.get(name, supported) != supported:
                raise ValueError(
                    f"{CONFIG_FILE}: {name} is {content[name]!r}: only {supported!r} is supported for BERT"
                )
        return convert_document(dict(content), cls, CONFIG_FILE, CONFIG_CURE)

    @property
    def width(self) -> int:
        """Features of a token."""
        return self.hidden_size

    @property
    def max_tokens(self) -> int:
        """Tokens that have a position."""
        return self.max_position_embeddings


class BertLayer(nnx.Module):
    """x = LN(x + attention(x)), x = LN(x + MLP(x))."""

    def __init__(self, config: BertConfig, *, init: ParamInit):
        width, eps = config.hidden_size, config.layer_norm_eps
        self.query = Linear(width, width, init=init, std=_STD)
        self.key = Linear(width, width, init=init, std=_STD)
        self.value = Linear(width, width, init=init, std=_STD)
        self.out = Linear(width, width, init=init, std=_STD)
        self.norm = LayerNorm(width, eps)
        self.up = Linear(width, config.intermediate_size, init=init, std=_STD)
        self.down = Linear(config.intermediate_size, width, init=init, std=_STD)
        self.out_norm = LayerNorm(width, eps)
        self.heads = config.num_attention_heads

    def __call__(self, x: Float[Array, "b t d"], mask: Bool[Array, "b t"]) -> Float[Array, "b t d"]:
        attended = attend(self.query(x), self.key(x), self.value(x), mask[:, None], self.heads)
        x = self.norm(x + self.out(attended))
        return self.out_norm(x + self.down(jax.nn.gelu(self.up(x), approximate=False)))


class Bert(nnx.Module):
    """Token ids -> last hidden states."""

    def __init__(self, config: BertConfig, *, init: ParamInit):
        def table(rows: int) -> nnx.Param:
            return nnx.Param(init.normal((rows, config.hidden_size), _STD))

        self.words, self.positions, self.segments = (
            table(config.vocab_size),
            table(config.max_position_embeddings),
            table(config.type_vocab_size),
        )
        self.norm = LayerNorm(config.hidden_size, config.layer_norm_eps)
        self.layers = nnx.List([BertLayer(config, init=init) for _ in range(config.num_hidden_layers)])

    def __call__(self, ids: Int[Array, "b t"], mask: Bool[Array, "b t"]) -> Float[Array, "b t d"]:
        """Features of every token; padding (``mask`` False) never changes those of others."""
        x = self.words[...][ids] + self.positions[...][None, : ids.shape[1]] + self.segments[...][:1][None]
        x = self.norm(x)
        for layer in self.layers:
            x = layer(x, mask)
        return jnp.where(mask[..., None], x, 0.0)


def bert_table_shapes(config: BertConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that decide all sizes."""
    width = config.hidden_size
    return {
        "embeddings.word_embeddings.weight": (config.vocab_size, width),
        "embeddings.position_embeddings.weight": (config.max_position_embeddings, width),
        "embeddings.token_type_embeddings.weight": (config.type_vocab_size, width),
        "encoder.layer.0.intermediate.dense.weight": (config.intermediate_size, width),
    }


def first_layers(config: Any, state: Mapping[str, np.ndarray], number: int) -> tuple[BertConfig, dict[str, np.ndarray]]:
    """The config and the arrays of the first layers of a BERT.

    Raises:
      ValueError: the network is no BERT, or has fewer layers.
    """
    if not isinstance(config, BertConfig) or not 1 <= number <= config.num_hidden_layers:
        raise ValueError(f"it has no {number} layers of a BERT")
    rest = tuple(f"encoder.layer.{k}." for k in range(number, config.num_hidden_layers))
    kept = {name: array for name, array in state.items() if not name.startswith(rest)}
    return dataclasses.replace(config, num_hidden_layers=number), kept


def bert_weight_rules(config: BertConfig) -> Rules:
    """Keys of a transformers state dict (without the prefix "bert.") -> parameters and layout changes."""
    rules: dict[str, Any] = {
        "embeddings.word_embeddings.weight": (("words",), SAME),
        "embeddings.position_embeddings.weight": (("positions",), SAME),
        "embeddings.token_type_embeddings.weight": (("segments",), SAME),
        **_norm("embeddings.LayerNorm", ("norm",)),
    }
    linears = {
        "attention.self.query": "query",
        "attention.self.key": "key",
        "attention.self.value": "value",
        "attention.output.dense": "out",
        "intermediate.dense": "up",
        "output.dense": "down",
    }
    for k in range(config.num_hidden_layers):
        start, path = f"encoder.layer.{k}", ("layers", k)
        for foreign, own in linears.items():
            rules[f"{start}.{foreign}.weight"] = ((*path, own, "kernel"), TRANSPOSE)
            rules[f"{start}.{foreign}.bias"] = ((*path, own, "bias"), SAME)
        rules |= _norm(f"{start}.attention.output.LayerNorm", (*path, "norm"))
        rules |= _norm(f"{start}.output.LayerNorm", (*path, "out_norm"))
    return rules


def _norm(foreign: str, path: tuple) -> dict[str, Any]:
    return {f"{foreign}.weight": ((*path, "scale"), SAME), f"{foreign}.bias": ((*path, "bias"), SAME)}


NETWORK = PublishedNetwork(
    read_config=BertConfig.from_json,
    module=Bert,
    table_shapes=bert_table_shapes,
    weight_rules=bert_weight_rules,
    is_unused=lambda name: name in _UNUSED,
    rename=lambda name: name.removeprefix("bert."),
)
