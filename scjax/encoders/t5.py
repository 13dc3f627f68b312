"""T5 and UMT5 encoders (Raffel et al. 2020; Chung et al. 2023): relative position biases, no scaling of scores.

UMT5 has a table of biases in every layer, T5 one for all of them. The paper's text encoder is UMT5-XXL.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from scjax.encoders.base import CONFIG_CURE, CONFIG_FILE, Epsilon, Layers, PublishedNetwork, Rows, Size
from scjax.nn.attention import merge_heads, split_heads
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear
from scjax.nn.state_dict import SAME, TRANSPOSE, Rules
from scjax.scene.document import convert_document

_STD = 0.02
_GATED, _PLAIN = "gated-gelu", "relu"


@dataclasses.dataclass(frozen=True, kw_only=True)
class T5Config:
    """Sizes, named as in ``config.json`` of the transformers library.

    Attributes:
      feed_forward_proj: "gated-gelu" (T5 1.1, UMT5) or "relu" (the first T5).
      bias_per_layer: a table of position biases in every layer (UMT5) or in the first one, for all (T5).
    """

    vocab_size: Rows = 256384
    d_model: Size = 512
    d_kv: Size = 64
    d_ff: Size = 1024
    num_layers: Layers = 8
    num_heads: Size = 6
    relative_attention_num_buckets: Annotated[int, msgspec.Meta(ge=4, le=2**16)] = 32
    relative_attention_max_distance: Size = 128
    layer_norm_epsilon: Epsilon = 1e-6
    feed_forward_proj: str = _GATED
    bias_per_layer: bool = True

    def __post_init__(self):
        if self.feed_forward_proj not in (_GATED, _PLAIN):
            raise ValueError(f"feed_forward_proj is {self.feed_forward_proj!r}: only {_GATED!r} and {_PLAIN!r} exist")
        if self.relative_attention_max_distance <= self.relative_attention_num_buckets // 4:
            raise ValueError("relative_attention_max_distance must exceed a quarter of relative_attention_num_buckets")

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> T5Config:
        """Sizes from the content of a ``config.json``.

        Raises:
          ValueError: a field of another type or out of its range, or a variant of T5 that this network is not.
        """
        is_umt5 = content.get("model_type") == "umt5"
        return convert_document({**content, "bias_per_layer": is_umt5}, cls, CONFIG_FILE, CONFIG_CURE)

    @property
    def width(self) -> int:
        """Features of a token."""
        return self.d_model

    @property
    def max_tokens(self) -> int:
        """Tokens that the release reads at most; relative positions themselves set no limit."""
        return 512


class RMSNorm(nnx.Module):
    """x / sqrt(mean(x^2) + eps) * scale."""

    def __init__(self, features: int, eps: float):
        self.scale = nnx.Param(jnp.ones(features))
        self.eps = eps

    def __call__(self, x: Float[Array, "b t d"]) -> Float[Array, "b t d"]:
        x = x * jax.lax.rsqrt(jnp.square(x).mean(-1, keepdims=True) + self.eps)
        return x * self.scale[...][None, None]


class T5Layer(nnx.Module):
    """x = x + attention(norm(x)), x = x + MLP(norm(x)); linear layers have no biases."""

    def __init__(self, config: T5Config, has_bias: bool, *, init: ParamInit):
        width, inner = config.d_model, config.num_heads * config.d_kv

        def linear(before: int, after: int) -> Linear:
            return Linear(before, after, init=init, bias=False, std=_STD)

        self.norm = RMSNorm(width, config.layer_norm_epsilon)
        self.query, self.key, self.value = (linear(width, inner) for _ in range(3))
        self.out = linear(inner, width)
        shape = (config.relative_attention_num_buckets, config.num_heads)
        self.biases = nnx.Param(init.normal(shape, _STD)) if has_bias else None
        self.mlp_norm = RMSNorm(width, config.layer_norm_epsilon)
        self.gate = linear(width, config.d_ff) if config.feed_forward_proj == _GATED else None
        self.up = linear(width, config.d_ff)
        self.down = linear(config.d_ff, width)
        self.heads = config.num_heads

    def __call__(
        self, x: Float[Array, "b t d"], mask: Bool[Array, "b t"], biases: Float[Array, "h t t"]
    ) -> Float[Array, "b t d"]:
        normed = self.norm(x)
        q, k, v = (split_heads(part(normed), self.heads) for part in (self.query, self.key, self.value))
        scores = q @ k.swapaxes(-1, -2) + biases[None]
        weights = jax.nn.softmax(jnp.where(mask[:, None, None], scores.astype(jnp.float32), -1e30))
        x = x + self.out(merge_heads(weights.astype(x.dtype) @ v))
        normed = self.mlp_norm(x)
        up = self.up(normed)
        inner = jax.nn.relu(up) if self.gate is None else jax.nn.gelu(self.gate(normed), approximate=True) * up
        return x + self.down(inner)


class T5(nnx.Module):
    """Token ids -> features after the last norm."""

    def __init__(self, config: T5Config, *, init: ParamInit):
        self.words = nnx.Param(init.normal((config.vocab_size, config.d_model), 1.0))
        self.layers = nnx.List(
            [T5Layer(config, config.bias_per_layer or k == 0, init=init) for k in range(config.num_layers)]
        )
        self.norm = RMSNorm(config.d_model, config.layer_norm_epsilon)
        self.config = config

    def __call__(self, ids: Int[Array, "b t"], mask: Bool[Array, "b t"]) -> Float[Array, "b t d"]:
        """Features of every token, zero at padding (as the release does), which never changes those of others."""
        config = self.config
        position = np.arange(ids.shape[1])
        bucket = position_bucket(
            position[None] - position[:, None],
            config.relative_attention_num_buckets,
            config.relative_attention_max_distance,
        )
        x, biases = self.words[...][ids], None
        for layer in self.layers:
            if layer.biases is not None:
                biases = layer.biases[...][bucket].transpose(2, 0, 1)
            assert biases is not None  # the first layer always has its own
            x = layer(x, mask, biases)
        return jnp.where(mask[..., None], self.norm(x), 0.0)


def position_bucket(offset: Int[np.ndarray, "q k"], buckets: int, farthest: int) -> Int[np.ndarray, "q k"]:
    """Bucket of a relative position (key minus query): linear nearby, then logarithmic, half of them for each sign."""
    half = buckets // 2
    near = half // 2
    distance = np.abs(offset)
    scale = (half - near) / math.log(farthest / near)
    far = near + (np.log(np.maximum(distance, 1).astype(np.float32) / near) * scale).astype(int)
    return half * (offset > 0) + np.where(distance < near, distance, np.minimum(far, half - 1))


def t5_table_shapes(config: T5Config) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that decide all sizes."""
    start, width = "encoder.block.0.layer", config.d_model
    up = "wi_1" if config.feed_forward_proj == _GATED else "wi"
    return {
        "shared.weight": (config.vocab_size, width),
        f"{start}.0.SelfAttention.q.weight": (config.num_heads * config.d_kv, width),
        f"{start}.0.SelfAttention.relative_attention_bias.weight": (
            config.relative_attention_num_buckets,
            config.num_heads,
        ),
        f"{start}.1.DenseReluDense.{up}.weight": (config.d_ff, width),
    }


def t5_weight_rules(config: T5Config) -> Rules:
    """Keys of a transformers state dict -> parameters and layout changes."""
    rules: dict[str, Any] = {
        "shared.weight": (("words",), SAME),
        "encoder.final_layer_norm.weight": (("norm", "scale"), SAME),
    }
    gated = config.feed_forward_proj == _GATED
    for k in range(config.num_layers):
        start, path = f"encoder.block.{k}.layer", ("layers", k)
        names = {f"0.SelfAttention.{a}": b for a, b in zip("qkvo", ("query", "key", "value", "out"), strict=True)}
        mlp = {"wi_0": "gate", "wi_1": "up", "wo": "down"} if gated else {"wi": "up", "wo": "down"}
        names |= {f"1.DenseReluDense.{foreign}": own for foreign, own in mlp.items()}
        for foreign, own in names.items():
            rules[f"{start}.{foreign}.weight"] = ((*path, own, "kernel"), TRANSPOSE)
        rules[f"{start}.0.layer_norm.weight"] = ((*path, "norm", "scale"), SAME)
        rules[f"{start}.1.layer_norm.weight"] = ((*path, "mlp_norm", "scale"), SAME)
        if config.bias_per_layer or k == 0:
            rules[f"{start}.0.SelfAttention.relative_attention_bias.weight"] = ((*path, "biases"), SAME)
    return rules


NETWORK = PublishedNetwork(
    read_config=T5Config.from_json,
    module=T5,
    table_shapes=t5_table_shapes,
    weight_rules=t5_weight_rules,
    is_unused=lambda name: name.startswith(("decoder.", "lm_head.")),
    aliases=(("encoder.embed_tokens.weight", "shared.weight"),),
)
