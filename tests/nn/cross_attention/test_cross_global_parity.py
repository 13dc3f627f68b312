"""Cross-global attention in isolation against crossglobal_*.npz, and its masks."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.convert.denoiser import cross_global_rules
from scjax.nn.cross_attention import ContextSpec
from scjax.nn.cross_attention.cross_global import CrossGlobal, CrossGlobalOptions
from scjax.nn.functional import functional
from scjax.nn.state_dict import convert
from tests.factories import golden

MODULES = {"lane": "model.blocks.0.l2l_blocks.0.cross_attn", "agent": "model.blocks.0.a2a_block.cross_attn"}


@pytest.mark.parametrize("kind", MODULES)
def test_cross_global_parity(parity_dir, kind):
    inputs, outputs = (golden.load(parity_dir, f"crossglobal_{part}.npz") for part in ("inputs", "outputs"))
    weights = golden.load(parity_dir, "text_weights.npz")
    sizes = golden.config_of(parity_dir)["denoiser"]
    width, heads = sizes[f"{kind}_width"], sizes[f"{kind}_heads"]
    options = CrossGlobalOptions(latent_tokens=sizes["latent_tokens"])
    module = functional(lambda init: CrossGlobal(options, width, heads, ContextSpec(), init=init))
    rules, prefix = cross_global_rules(MODULES[kind]), MODULES[kind] + "."
    state = {key: value for key, value in weights.items() if key.startswith(prefix)}
    params = jax.tree.map(jnp.asarray, convert(state, rules, jax.eval_shape(module.init, jax.random.key(0))))
    seen = set()
    for case in ("single", "batch"):
        q, kv, scene = (inputs[f"{kind}/{case}/{name}"] for name in ("q", "kv", "scene_of_query"))
        members = [np.flatnonzero(scene == i) for i in range(len(kv))]
        x = golden.padded([q[rows] for rows in members])
        real = golden.padded([np.ones(len(rows), bool) for rows in members])
        mask = jnp.ones(kv.shape[:2], bool)

        @golden.jit
        def run(params, x, real, kv, mask):
            trace = {}
            cache = module.apply(params, kv, mask, trace, method="encode")
            return module.apply(params, x, real, cache, trace, method="attend")[0], trace

        values = {}
        for gate in (0.0, 0.7):
            y, trace = run({**params, "gate": jnp.full(1, gate)}, x, real, jnp.asarray(kv), mask)
            values |= trace | {f"out_gate{gate}": y}
        for name, value in values.items():
            key = f"{kind}/{case}/{name}"
            reference = outputs[key]
            if len(reference) == len(q) and reference.ndim == 2:  # a row a query
                value = np.concatenate([value[i, : len(rows)] for i, rows in enumerate(members)])
                reference = reference[np.concatenate(members)]
            assert golden.relative(value, reference, key) < 1e-5, key
            seen.add(key)
    assert seen == {key for key in outputs if key.startswith(f"{kind}/")}


@pytest.fixture(scope="module")
def module():
    options = CrossGlobalOptions(latent_tokens=4)
    made = functional(lambda init: CrossGlobal(options, 16, 2, ContextSpec(), init=init))
    params = made.init(jax.random.key(0))
    params = jax.tree.map(lambda x: x + 0.1 * jax.random.normal(jax.random.key(1), x.shape), params)

    @jax.jit
    def run(params, x, context, mask):
        cache = made.apply(params, context, mask, method="encode")
        return made.apply(params, x, jnp.ones(x.shape[:2], bool), cache, method="attend")[0]

    return params, run


def _case():
    x, context = (jax.random.normal(jax.random.key(i), (2, n, 16)) for i, n in ((2, 5), (3, 6)))
    return x, context, jnp.arange(6)[None] < jnp.array([[6], [3]])


def test_scene_without_context_gives_zero(module):
    params, run = module
    x, context, mask = _case()
    mask = mask.at[0].set(False)
    y = run(params, x, context, mask)
    assert not np.any(y[0]) and np.any(y[1])
    gradient = jax.grad(lambda params, x: (run(params, x, context, mask)[0] ** 2).sum(), (0, 1))(params, x)
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize("garbage", [np.nan, np.inf, 1e30])
def test_masked_context_never_matters(module, garbage):
    params, run = module
    x, context, mask = _case()

    def loss(params, x, context):
        return jnp.sin(run(params, x, context, mask)).sum()

    dirty = jnp.where(mask[..., None], context, garbage)
    clean = jax.value_and_grad(loss, (0, 1, 2))(params, x, context)
    spoilt = jax.value_and_grad(loss, (0, 1, 2))(params, x, dirty)
    jax.tree.map(np.testing.assert_array_equal, clean, spoilt)
    # A shorter context without the padding gives the same.
    alone = run(params, x[1:], context[1:, :3], mask[1:, :3])
    np.testing.assert_allclose(alone[0], run(params, x, dirty, mask)[1], rtol=1e-5, atol=1e-6)


def test_closed_gate_leaves_the_direct_path(module):
    params, run = module
    x, context, mask = _case()
    shut = {**params, "gate": jnp.zeros(1)}
    changed = {**shut, "latents": params["latents"] + 1.0}
    np.testing.assert_array_equal(run(shut, x, context, mask), run(changed, x, context, mask))
