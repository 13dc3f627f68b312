"""The training loss and its gradients against train_*.npz."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.convert.denoiser import convert_denoiser, denoiser_rules
from scjax.diffusion.loss import diffusion_loss, noise_latents
from scjax.diffusion.schedule import cosine_schedule
from scjax.models.denoiser.model import denoiser
from scjax.nn.state_dict import flatten, unflatten
from scjax.scene.per_type import PerType
from tests.factories import golden

TOLERANCE = 1e-5
_KNOWN = ("agent_partition_mask", "lane_partition_mask")


@pytest.fixture(scope="module", params=["uncond", "text", "image"])
def case(request, parity_dir):
    condition = request.param
    config = golden.denoiser_config(parity_dir, condition)
    inputs = golden.load(parity_dir, "train_inputs.npz")
    expected = golden.load(parity_dir, f"train_{condition}.npz")
    leaves = flatten(convert_denoiser(golden.load(parity_dir, f"{condition}_weights.npz"), config))
    network = denoiser(config)
    names = [f"s{k}" for k in range(golden.scenes(inputs))]
    clean, noise, known = (
        golden.pair(inputs, names, *keys) for keys in (("x0_agent", "x0_lane"), ("noise_agent", "noise_lane"), _KNOWN)
    )
    masks = golden.masks(inputs, names, "x0_agent", "x0_lane")
    level = cosine_schedule().levels[jnp.asarray(inputs["t"])]
    features = golden.features(inputs, names, condition)

    stored = golden.load(parity_dir, f"train_{condition}_grads.npz")
    rules = denoiser_rules(config)
    stored_paths = {rules[key][0] for key in stored}

    def loss(chosen, others, label, dropped, agent_weight):
        params = unflatten({**others, **chosen})
        cache = None
        if features is not None:
            cache = network.apply(params, features, dropped, method="encode_condition")
        estimates = []

        def denoise(z, t):
            estimates.append(network.apply(params, z, t, label, masks, cache=cache))
            return estimates[-1]

        total, terms = diffusion_loss(
            denoise, level, clean, noise, masks, known, agent_weight=agent_weight, count_known=True
        )
        return total, (terms, estimates[-1])

    in_view = golden.padded([inputs[f"{s}/agent_fov_mask"] | (inputs[f"{s}/fov_uniform"] > 0.5) for s in names])
    label = golden.labels(config, inputs, names)
    no_dropout, unit_weight = jnp.zeros(len(names), bool), jnp.ones_like(masks.agents, jnp.float32)
    null = jnp.where(jnp.asarray(inputs["label_uniform"]) < 0.1, config.null_label, label)
    dropped = jnp.asarray(inputs["condition_uniform"]) < 0.5 if condition == "text" else no_dropout
    variants = {
        "plain": (label, no_dropout, unit_weight),
        "dropout": (null, dropped, unit_weight),
        "fov": (label, no_dropout, in_view.astype(jnp.float32)),
    }
    # One program for all variants; only the stored gradients are computed.
    evaluate = golden.jit(jax.value_and_grad(loss, has_aux=True))
    chosen = {path: leaf for path, leaf in leaves.items() if path in stored_paths}
    others = {path: leaf for path, leaf in leaves.items() if path not in stored_paths}
    results = {
        name: evaluate(chosen, others, *arguments)
        for name, arguments in variants.items()
        if f"{name}/mean/total" in expected
    }
    inputs_at_t = noise_latents(level, clean, noise, known)[0]
    return {
        "condition": condition,
        "expected": expected,
        "stored": stored,
        "rules": rules,
        "names": names,
        "x_t": inputs_at_t,
        "results": results,
    }


def test_train_parity(case):
    expected, seen = case["expected"], set()
    for variant, ((total, (terms, eps)), _) in case["results"].items():
        values = {f"per_scene/{name}": term for name, term in terms.items()}
        values |= {f"mean/{name}": term.mean() for name, term in terms.items()}
        for k, scene in enumerate(case["names"]):
            pairs = {"eps": eps, "x_t": case["x_t"]}
            values |= {f"{scene}/{name}_agent": pair.agents[k] for name, pair in pairs.items()}
            values |= {f"{scene}/{name}_lane": pair.lanes[k] for name, pair in pairs.items()}
        for key in [key for key in expected if key.startswith(f"{variant}/")]:
            value = values[key.removeprefix(f"{variant}/")]
            value = value[: len(expected[key])] if expected[key].ndim else value
            assert golden.relative(value, expected[key], key) < TOLERANCE, key
            seen.add(key)
        np.testing.assert_allclose(total, expected[f"{variant}/mean/total"], rtol=TOLERANCE)
    assert seen == set(expected)


def test_train_gradients_parity(case):
    gradients, worst = case["results"]["plain"][1], 0.0
    for key, reference in case["stored"].items():
        path, transform = case["rules"][key]
        value = transform.backward(np.asarray(gradients[path]))
        scale = np.linalg.norm(reference)
        error = np.abs(value - reference).max()
        assert error <= 1e-4 * scale + 1e-7, f"{key}: {error:.1e} of {scale:.1e}"
        if scale > 1e-5:
            worst = max(worst, error / scale)
    print(f"{case['condition']}: {len(gradients)} gradients, largest error {worst:.1e} of the norm")


def test_known_tokens_leave_the_mean_by_default():
    flags = PerType(agents=jnp.array([[True, False]]), lanes=jnp.array([[True, True]]))
    ones = PerType(agents=jnp.ones((1, 2, 3)), lanes=jnp.ones((1, 2, 4)))
    masks = jax.tree.map(jnp.ones_like, flags)

    def loss(count_known):
        return diffusion_loss(
            lambda z, t: jax.tree.map(lambda x: 3 * jnp.ones_like(x), z),
            cosine_schedule().levels[jnp.array([50])],
            ones,
            ones,
            masks,
            flags,
            count_known=count_known,
        )[1]

    assert loss(False)["agent"][0] == 2.0 and loss(False)["lane"][0] == 0.0  # 0.5 (3 - 1)^2; every lane is known
    assert loss(True)["agent"][0] == (2.0 + 4.5) / 2 and loss(True)["lane"][0] == 4.5
