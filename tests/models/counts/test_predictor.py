from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from scjax.models.counts.on_host import count_log_probabilities
from scjax.models.counts.predictor import CountPredictorConfig, count_loss, count_predictor
from scjax.models.denoiser.context import TextFeatures

CONFIG = CountPredictorConfig(text_width=6, domains=2, width=16, queries=2, heads=2, max_lanes=9, max_agents=7)


def texts(seed=0, rows=3, slots=5) -> TextFeatures:
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, slots + 1, rows)
    return TextFeatures(
        tokens=jnp.asarray(rng.normal(size=(rows, slots, 6)), jnp.float32),
        mask=jnp.arange(slots)[None] < lengths[:, None],
    )


@pytest.fixture(scope="module")
def network():
    """The network, compiled, and its parameters."""
    network = count_predictor(CONFIG)
    return jax.jit(network.apply), network.init(jax.random.key(1))


def test_predictor_gives_a_distribution(network):
    apply, params = network
    shares = np.exp(apply(params, texts(), jnp.array([0, 1, 2])))
    np.testing.assert_allclose(shares.sum((1, 2)), 1.0, atol=1e-5)
    assert shares[:, 0].max() < 1e-6 and shares[:, :, 0].max() < 1e-6


def test_predictor_ignores_padding(network):
    apply, params = network
    text = texts()
    garbage = text.replace(tokens=jnp.where(text.mask[..., None], text.tokens, jnp.nan))
    longer = text.replace(
        tokens=jnp.pad(text.tokens, ((0, 0), (0, 4), (0, 0))), mask=jnp.pad(text.mask, ((0, 0), (0, 4)))
    )
    domain = jnp.zeros(3, int)
    for other in (garbage, longer):
        np.testing.assert_allclose(apply(params, other, domain), apply(params, text, domain), atol=1e-5)


def test_predictor_on_the_host_is_the_same(network):
    apply, params = network
    text = texts()
    for domain in range(CONFIG.domains + 1):
        expected = apply(params, text, jnp.full(3, domain))
        for row, (tokens, mask) in enumerate(zip(text.tokens, text.mask, strict=True)):
            actual = count_log_probabilities(CONFIG, params, np.asarray(tokens)[np.asarray(mask)], domain)
            np.testing.assert_allclose(actual[1:, 1:], expected[row, 1:, 1:], atol=2e-5)
            assert actual[0].max() < -1e8 and actual[:, 0].max() < -1e8


def test_config_needs_one_name_for_each_feature():
    with pytest.raises(ValueError, match="has 1 attributes, but text_width 6"):
        CountPredictorConfig(text_width=6, domains=2, attributes=("layout=T",))


def test_predictor_learns_counts_from_text(network):
    """Token k stands for k lanes and 8 - k agents."""
    apply, params = network
    numbers = jnp.arange(1, 7)
    text = TextFeatures(tokens=jax.nn.one_hot(numbers - 1, 6)[:, None], mask=jnp.ones((6, 1), bool))
    domain, optimizer = jnp.full(6, 2), optax.adam(1e-2)

    @jax.jit
    def step(params, moments):
        (_, terms), gradient = jax.value_and_grad(
            lambda p: count_loss(apply(p, text, domain), numbers, 8 - numbers), has_aux=True
        )(params)
        updates, moments = optimizer.update(gradient, moments)
        return optax.apply_updates(params, updates), moments, terms

    moments = optimizer.init(params)
    for _ in range(150):
        params, moments, terms = step(params, moments)
    assert float(terms["lanes_mae"]) < 0.2 and float(terms["agents_mae"]) < 0.2


@pytest.mark.parametrize("change", [{"width": 0}, {"width": 15}])
def test_config_rejects_bad_sizes(change):
    with pytest.raises(ValueError, match=r"CountPredictorConfig\.width"):
        CountPredictorConfig(**{"text_width": 4, "domains": 1, **change})
