"""Unit vectors along headings, for loops over pairs of agents. Jitted."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from scjax.scene.scene import AnyArray

_IDENTITY = np.eye(2, dtype=np.float32)


def directions(heading: Float[AnyArray, " N"]) -> tuple[Float[AnyArray, " N"], Float[AnyArray, " N"]]:
    """Cosines and sines of headings, each computed once.

    XLA fuses what is computed element by element into what reads it: a loop over pairs of agents would compute both
    again for every pair, which takes longer than the pair. A matrix product is not fused, and one with the identity
    changes no value.
    """
    vectors = jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=-1)
    vectors = jnp.matmul(vectors, _IDENTITY, precision=jax.lax.Precision.HIGHEST)
    return vectors[:, 0], vectors[:, 1]
