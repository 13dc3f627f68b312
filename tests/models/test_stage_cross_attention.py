"""Does a conditioned stage learn from its initial values? (attention-variants §4.3, §9 "dead start")"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import nnx

from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.stage import AttentionStage
from scjax.nn.cross_attention import ContextSpec, GatedOptions, from_name
from scjax.nn.functional import flatten, functional, unflatten
from scjax.train.ema import update_ema
from scjax.train.optimizer import adamw
from tests.factories import golden

WIDTH, HEADS, STEPS = 8, 2, 4
IMAGE = ContextSpec(kind="image", grid=(2, 2), modalities=2)
OPTIONS = {
    "concat": {},
    "full": {"memory_tokens": 2},
    "gated": {"feed_forward": True},
    "linear": {"dwc": "value"},
    "agent": {"tokens": 3, "pooling": "set", "grid_bias": True},
    "saap": {"mode": "joint", "buckets": 4, "probes": 2, "router_width": 5},
    "windowed": {"window": 1},
    "deformable": {"points": 2},
    "squeezed": {"rule": "top", "clusters": 3},
    "cross_global": {"latent_tokens": 3},
}
STATISTICS = {"fitted", "threshold"}
UNSEEN = {("stage", "cross", "k_norm", "bias"), ("stage", "k", "bias")}  # shift all logits of a row: no softmax sees it


class Conditioned(nnx.Module):
    """A stage that encodes what it reads."""

    def __init__(self, name, adaln_init, *, init):
        self.stage = AttentionStage(
            WIDTH,
            HEADS,
            init=init,
            mlp_ratio=1,
            cross_attention=from_name(name, **OPTIONS[name]),
            spec=IMAGE,
            cross_adaln_init=adaln_init,
        )

    def __call__(self, x, mask, to, context):
        assert self.stage.cross is not None
        cache = self.stage.cross.encode(context, jnp.ones(context.shape[:2], bool))
        return self.stage(x, mask, self.stage.modulation(to), mask, None, cache)


@functools.cache
def _step(name):
    """One step of the project's optimiser and moving average, without warm-up and decay, which also move leaves."""
    made, rng = functional(lambda init: Conditioned(name, "zero", init=init)), np.random.default_rng(0)
    x, to, context, target = (
        jnp.asarray(rng.normal(size=(2, *size)), jnp.float32) for size in ((6, WIDTH), (WIDTH,), (8, WIDTH), (6, WIDTH))
    )
    mask = jnp.arange(6)[None] < jnp.array([[6], [4]])
    optimizer = adamw(learning_rate=1e-2, steps=10, warmup=0, weight_decay=0.0)

    def loss(params):
        y, aux = made.apply(params, x, mask, to, context)
        return jnp.where(mask[..., None], jnp.square(y - target), 0).mean() + (0 if aux.loss is None else aux.loss)

    @golden.jit
    def step(params, ema, moments, number):
        updates, moments = optimizer.update(jax.grad(loss)(params), moments, params)
        params = optax.apply_updates(params, updates)
        return params, update_ema(ema, params, number, 0.9), moments

    return optimizer, step


def _history(name, adaln_init, **changes):
    """The leaves at the start and after each step, and the moving average at the end; ``changes`` of initial leaves."""
    params = functional(lambda init: Conditioned(name, adaln_init, init=init)).init(jax.random.key(0))
    leaves = flatten(params)
    params = unflatten({path: changes.get(path[-1], leaf) for path, leaf in leaves.items()})
    optimizer, step = _step(name)
    ema, moments, history = params, optimizer.init(params), [jax.device_get(flatten(params))]
    for number in range(1, STEPS + 1):
        params, ema, moments = step(params, ema, moments, number)
        history.append(jax.device_get(flatten(params)))
    return history, jax.device_get(flatten(ema))


def _unlocked(history):
    """Leaf -> the first step that changed it (None: none)."""
    changed = {path: [not np.array_equal(leaves[path], history[0][path]) for leaves in history] for path in history[0]}
    return {path: steps.index(True) if any(steps) else None for path, steps in changed.items()}


@pytest.mark.parametrize("name", OPTIONS)
def test_all_trained_parameters_get_gradients(name):
    for adaln_init in ("zero", "xavier"):
        history, ema = _history(name, adaln_init)
        unlocked = _unlocked(history)
        still = {path for path, step in unlocked.items() if step is None}
        statistics = {path for path in unlocked if path[-1] in STATISTICS}
        assert still - UNSEEN == statistics, adaln_init
        for path in statistics:
            np.testing.assert_array_equal(ema[path], history[0][path])
        assert all(np.all(np.isfinite(leaf)) for leaf in history[-1].values())
        if adaln_init == "zero":
            assert unlocked["stage", "cross_adaln", "kernel"] == 1
            inside = [step for path, step in unlocked.items() if path[1] == "cross" and step is not None]
            if name != "saap":  # its own loss trains its classifier at once
                assert min(inside) == 2


def test_cross_global_learns_gates_first():
    unlocked = _unlocked(_history("cross_global", "zero")[0])
    order = {path[2]: step for path, step in unlocked.items() if path[1] == "cross"}
    assert unlocked["stage", "cross_adaln", "kernel"] == 1
    assert {order[part] for part in ("q", "k", "v", "out", "gate")} == {2}
    assert {order[part] for part in ("latents", "latent_q", "latent_k", "latent_v", "latent_out")} == {3}


def test_gated_with_two_zeros_never_trains():
    """A closed gate behind AdaLN that starts at zero: stuck for ever; Flamingo's start with AdaLN that does not."""
    shut = {"gate": jnp.zeros(1)}
    stuck = _unlocked(_history("gated", "zero", **shut)[0])
    assert all(step is None for path, step in stuck.items() if path[1] in ("cross", "cross_adaln"))
    free = _unlocked(_history("gated", "xavier", **shut)[0])
    assert free["stage", "cross", "gate"] == 1 and free["stage", "cross", "q", "kernel"] == 2
    with pytest.raises(ValueError, match="never trains"):
        DenoiserConfig(cross_attention=GatedOptions(start=0.0))
    assert DenoiserConfig(
        cross_attention=GatedOptions(start=0.0), cross_adaln_init="xavier"
    ).cross_attention == GatedOptions(start=0.0)
