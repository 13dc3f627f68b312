"""Convolutions of image networks, channels last: padded, strided, and transposed without overlap."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from scjax.nn.cpu.precision import Compute, operands
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear

_STD = 0.02


class Conv(nnx.Module):
    """2-D convolution with zeros around the input; sums are float32, whatever the operands are."""

    def __init__(
        self,
        channels_in: int,
        channels_out: int,
        size: int,
        *,
        init: ParamInit,
        stride: int = 1,
        bias: bool = True,
        compute: Compute = "float32",
    ):
        self.kernel = nnx.Param(init.normal((size, size, channels_in, channels_out), _STD))
        self.bias = nnx.Param(jnp.zeros(channels_out)) if bias else None
        self.stride = stride
        self.compute: Compute = compute

    def __call__(self, x: Float[Array, "b h w i"]) -> Float[Array, "b rows columns o"]:
        dtype = jnp.bfloat16 if operands(self.compute) == "bfloat16" else jnp.float32
        padding = self.kernel.shape[0] // 2
        y = jax.lax.conv_general_dilated(
            x.astype(dtype),
            self.kernel[...].astype(dtype),
            window_strides=(self.stride, self.stride),
            padding=((padding, padding), (padding, padding)),
            dimension_numbers=("NHWC", "HWIO", "NHWC"),
            preferred_element_type=jnp.float32,
        )
        return y if self.bias is None else y + self.bias[...][None, None, None]


class PixelExpansion(nnx.Module):
    """Transposed convolution whose stride is its size: every pixel becomes ``factor`` x ``factor`` pixels."""

    def __init__(
        self, channels_in: int, channels_out: int, factor: int, *, init: ParamInit, compute: Compute = "float32"
    ):
        self.linear = Linear(
            channels_in, factor * factor * channels_out, init=init, bias=False, compute=compute, std=_STD
        )
        self.bias = nnx.Param(jnp.zeros(channels_out))
        self.factor = factor

    def __call__(self, x: Float[Array, "b h w i"]) -> Float[Array, "b rows columns o"]:
        batch, height, width, _ = x.shape
        cells = self.linear(x).reshape(batch, height, width, self.factor, self.factor, -1)
        y = cells.swapaxes(2, 3).reshape(batch, height * self.factor, width * self.factor, -1)
        return y + self.bias[...][None, None, None]
