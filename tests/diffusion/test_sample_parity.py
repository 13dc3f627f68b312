"""One guided step and whole chains against p_sample_*.npz and chain_*.npz, with the stored noise."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.convert.denoiser import convert_denoiser
from scjax.diffusion.guidance import guided, join
from scjax.diffusion.sampler import CLIP, TEMPERATURE, clamp, denoise_step
from scjax.diffusion.schedule import cosine_schedule
from scjax.models.denoiser.model import denoiser
from scjax.models.nodes import Nodes
from tests import golden

GUIDANCE = 4.0
CHAINS = {
    "initial_scene": ("uncond", "chain_weights.npz", "chain_inputs.npz"),
    "lane_conditioned": ("uncond", "chain_weights.npz", "chain_inputs.npz"),
    "inpainting": ("uncond", "chain_weights.npz", "chain_inpainting_inputs.npz"),
    "text_initial_scene": ("text", "text_weights.npz", "chain_inputs.npz"),
    "image_initial_scene": ("image", "image_weights.npz", "chain_inputs.npz"),
}


def _pair(data, prefix, separator="_"):
    return Nodes(
        agents=jnp.asarray(data[f"{prefix}{separator}agent"]), lanes=jnp.asarray(data[f"{prefix}{separator}lane"])
    )


def _batched(tree, axis=0):
    return jax.tree.map(lambda x: jnp.expand_dims(x, axis), tree)


def _guided_denoise(config, params, inputs, kind, batch):
    """Guidance over ``batch`` copies of the one scene of ``inputs`` (both branches in one batch)."""
    network = denoiser(config)
    repeat = lambda tree: jax.tree.map(lambda x: jnp.repeat(x, batch, 0), tree)  # noqa: E731
    label = repeat(golden.labels(config, inputs, ["s"]))
    labels = join(label, jnp.full_like(label, config.null_label))
    dropped = jnp.arange(2 * batch) >= batch

    def denoise(z, t):
        masks = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), z)
        cache = None
        if kind != "uncond":
            features = repeat(golden.features(inputs, ["s"], kind))
            cache = network.apply(params, join(features, features), dropped, method="encode_condition")
        return network.apply(params, z, t, labels, masks, cache=cache)

    return guided(denoise, GUIDANCE)


@pytest.mark.parametrize("kind", ["uncond", "text", "image"])
def test_p_sample_parity(parity_dir, kind):
    inputs = golden.load(parity_dir, "p_sample_inputs.npz")
    expected = golden.load(parity_dir, f"p_sample_{kind}.npz")
    config = golden.denoiser_config(parity_dir, kind)
    params = convert_denoiser(golden.load(parity_dir, f"{kind}_weights.npz"), config)
    denoise, schedule = _guided_denoise(config, params, inputs, kind, 1), cosine_schedule()
    x, seen = _batched(_pair(inputs, "s/x")), set()

    @jax.jit
    def step(t, noise):
        unclipped = denoise_step(denoise, schedule, x, t, noise, clip=None)
        return denoise(x, t[None]), unclipped, denoise_step(denoise, schedule, x, t, noise)

    for t in sorted({int(key.split("/")[0][1:]) for key in expected}):
        eps, unclipped, clipped = step(jnp.asarray(t), _batched(_pair(inputs, f"t{t}/noise")))
        for name, pair in {"eps_{}": eps, "next_{}_unclipped": unclipped, "next_{}": clipped}.items():
            for kind_name, value in (("agent", pair.agents), ("lane", pair.lanes)):
                key = f"t{t}/{name.format(kind_name)}"
                tolerance = 5e-4 if t == 99 and name.startswith("next") else 2e-5
                error = golden.relative(value[0], expected[key], key)
                assert error < tolerance, f"{key}: {error:.1e}"
                seen.add(key)
    assert seen == set(expected)


@pytest.fixture(scope="module", params=CHAINS)
def chain(request, parity_dir):
    kind, weights, inputs = CHAINS[request.param]
    config = golden.denoiser_config(parity_dir, kind)
    return {
        "name": request.param, "kind": kind, "config": config,
        "params": convert_denoiser(golden.load(parity_dir, weights), config),
        "inputs": golden.load(parity_dir, inputs),
        "expected": golden.load(parity_dir, f"chain_{request.param}.npz"),
    }  # fmt: skip


def _given(chain, like):
    """Flags and values of the tokens that a chain keeps, or None."""
    inputs = chain["inputs"]
    flags = jax.tree.map(lambda x: jnp.zeros(x.shape[:2], bool), like)
    if chain["name"] == "lane_conditioned":
        flags = flags.replace(lanes=jnp.ones_like(flags.lanes))
    elif chain["name"] == "inpainting":
        flags = Nodes(agents=inputs["s/agent_given_mask"][None], lanes=inputs["s/lane_given_mask"][None])
        flags = jax.tree.map(jnp.asarray, flags)
    else:
        return None, None
    return flags, _batched(_pair(inputs, "s/given"))


def test_chain_steps_parity(chain):
    """Every step from the stored state before it; all hundred in one batch."""
    expected, inputs = chain["expected"], chain["inputs"]
    states, noise = _pair(expected, "states"), _pair(inputs, "step_noise")
    steps = jnp.arange(99, -1, -1)
    before, after = jax.tree.map(lambda x: x[:-1], states), jax.tree.map(lambda x: x[1:], states)
    noise = jax.tree.map(lambda x: x[::-1], noise)
    given, values = _given(chain, _batched(jax.tree.map(lambda x: x[0], before)))
    denoise = _guided_denoise(chain["config"], chain["params"], inputs, chain["kind"], 100)

    @jax.jit
    def run():
        eps = denoise(before, steps)

        def one(x, eps, step, noise):
            x = denoise_step(lambda z, t: _batched(eps), cosine_schedule(), _batched(x), step, _batched(noise))
            return jax.tree.map(lambda x: x[0], clamp(x, given, values))

        return jax.vmap(one)(before, eps, steps, noise)

    value = run()
    for kind in ("agents", "lanes"):
        for k, step in enumerate(steps):
            tolerance = 5e-4 if step == 99 else 1e-4
            error = golden.relative(getattr(value, kind)[k], getattr(after, kind)[k])
            assert error < tolerance, f"{kind}, t = {step}: {error:.1e}"


def test_whole_chain_parity(chain):
    """From the stored start to the end. Text and image chains (random weights) are compared only step by step."""
    if chain["kind"] != "uncond":
        chain["expected"]["final_lane"] = None  # nothing to compare
        return
    expected, inputs, schedule = chain["expected"], chain["inputs"], cosine_schedule()
    denoise = _guided_denoise(chain["config"], chain["params"], inputs, "uncond", 1)
    start = jax.tree.map(lambda x, scale: scale * x[None], _pair(inputs, "init_noise"), TEMPERATURE)
    given, values = _given(chain, start)
    noise = _batched(_pair(inputs, "step_noise"), 1)

    @jax.jit
    def run(x):
        def body(x, step):
            x = denoise_step(denoise, schedule, x, step, jax.tree.map(lambda n: n[step], noise))
            x = clamp(x, given, values)
            return x, x

        return jax.lax.scan(body, x, jnp.arange(99, -1, -1))

    start = clamp(start, given, values)
    end, states = run(start)
    for kind, name in (("agents", "agent"), ("lanes", "lane")):
        path = np.concatenate([getattr(start, kind), getattr(states, kind)[:, 0]])
        assert golden.relative(path[0], expected[f"states_{name}"][0]) < 1e-6
        assert golden.relative(path, expected[f"states_{name}"]) < 2e-2
        assert golden.relative(getattr(end, kind)[0], expected[f"final_{name}"]) < 5e-3
        assert np.abs(path[1:]).max() <= CLIP
