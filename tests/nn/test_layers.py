import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear, fused_linear

X = jax.random.normal(jax.random.key(1), (2, 5, 8))


def layers():
    numbers = jax.random.uniform(jax.random.key(0), (56,), minval=-1.0)
    init = ParamInit([numbers[:24], numbers[24:]])
    return [Linear(8, features, init=init) for features in (3, 4)]


def test_fused_linear_equals_separate_layers():
    for zeros in (0, 4):
        padded = jnp.pad(X, ((0, 0), (0, 0), (0, zeros)))
        for result, layer in zip(fused_linear(layers(), padded, zeros), layers(), strict=True):
            np.testing.assert_allclose(result, layer(X), 1e-5, 1e-5)


def test_fused_linear_rejects_other_widths():
    with pytest.raises(TypeError, match=r"matmul|contracting"):
        fused_linear(layers(), X[..., :7])
    with pytest.raises(TypeError, match=r"matmul|contracting"):
        fused_linear(layers(), jnp.pad(X, ((0, 0), (0, 0), (0, 5))), 4)
