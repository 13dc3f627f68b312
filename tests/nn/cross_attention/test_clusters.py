"""Spherical k-means of keys."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from scjax.nn.cross_attention.clusters import kmeans, nearest
from tests.factories.attention_cases import close, clustered_tokens


def test_kmeans_ignores_padding_and_order():
    points = clustered_tokens(1, 3, 20)[:, None]
    mask = np.arange(20)[None] < np.array([[20], [12], [0]])
    padded = np.where(mask[:, None, :, None], points, 1e3)
    centres = kmeans(jnp.asarray(padded), jnp.asarray(mask), 4, 5)
    similarity = np.einsum("bhmd,bhcd->bhmc", points, centres) / np.linalg.norm(points, axis=-1)[..., None]
    assert similarity.max(-1)[:2][mask[:2, None]].min() > 0.99
    centres_reversed = kmeans(jnp.asarray(points[:, :, ::-1]), jnp.asarray(mask[:, ::-1]), 4, 5)
    close(nearest(jnp.asarray(points), centres_reversed), nearest(jnp.asarray(points), centres))
