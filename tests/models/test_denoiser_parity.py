"""The denoiser against the official network: every array of denoiser_{uncond,text,image}.npz."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.convert.denoiser import convert_denoiser
from scjax.models.denoiser.context import depth_cells
from scjax.models.denoiser.model import denoiser
from tests.factories import golden

KINDS = ("uncond", "text", "image")
BRANCHES = ("cond", "uncond")
TOLERANCE = 1e-5


@pytest.fixture(scope="module", params=KINDS)
def case(request, parity_dir):
    """Everything of one kind: stored arrays, and a compiled evaluation of all scenes in both branches at once."""
    kind = request.param
    config = golden.denoiser_config(parity_dir, kind)
    inputs = golden.load(parity_dir, "denoiser_inputs.npz")
    expected = golden.load(parity_dir, f"denoiser_{kind}.npz")
    params = convert_denoiser(golden.load(parity_dir, f"{kind}_weights.npz"), config)
    network = denoiser(config)
    names = [f"s{k}" for k in range(golden.scenes(inputs))]
    rows = tuple(max(len(inputs[f"{s}/{x}"]) for s in names) + 2 for x in ("x_agent", "x_lane"))
    z = golden.pair(inputs, names, "x_agent", "x_lane", rows)
    masks = golden.masks(inputs, names, "x_agent", "x_lane", rows)
    label = golden.labels(config, inputs, names)
    twice = lambda tree: jax.tree.map(lambda x: jnp.concatenate([x, x]), tree)  # noqa: E731
    features = twice(golden.features(inputs, names, kind))
    z, masks, label = twice(z), twice(masks), jnp.concatenate([label, jnp.full(len(names), config.null_label)])
    dropped = jnp.arange(2 * len(names)) >= len(names)

    @golden.jit
    def run(params, t):
        trace = {}
        cache = None
        if features is not None:
            cache = network.apply(params, features, dropped, trace=trace, method="encode_condition")
        return network.apply(params, z, t, label, masks, cache=cache, trace=trace), trace

    return {
        "run": functools.partial(run, params),
        "expected": expected,
        "inputs": inputs,
        "names": names,
        "kind": kind,
    }


def test_denoiser_parity(case):
    expected, names, seen, worst = case["expected"], case["names"], set(), 0.0
    times = sorted({int(key.split("/")[1][1:]) for key in expected if key.startswith("s0/t")})
    for t in times:
        eps, trace = case["run"](jnp.full(2 * len(names), t))
        trace |= {"eps_lane": eps.lanes, "eps_agent": eps.agents}
        for k, scene in enumerate(names):
            for b, branch in enumerate(BRANCHES):
                for key in [key for key in expected if key.startswith(f"{scene}/t{t}/{branch}/")]:
                    name = key.removeprefix(f"{scene}/t{t}/{branch}/").removeprefix("act/")
                    # projections of image features: the same in both branches there, masked here where dropped
                    row = k if name in ("dino_proj", "depth_patch_mean", "depth_proj") else k + b * len(names)
                    value = trace[name][row]
                    error = golden.relative(value[: len(expected[key])], expected[key], key)
                    assert error < TOLERANCE, f"{key}: {error:.2e}"
                    worst = max(worst, error)
                    seen.add(key)
    print(f"{case['kind']}: {len(seen)} arrays, largest error {worst:.1e}")
    rest = {key for key in expected if key not in seen}
    assert {key.split("/")[0] for key in rest if not key.endswith("/depth_resized")} == {"batch"}


def test_denoiser_batch_parity(case):
    expected, names = case["expected"], case["names"]
    t = jnp.asarray(expected["batch/t"])
    eps, _ = case["run"](jnp.concatenate([t, t]))
    for key in expected:
        if key.startswith("batch/s"):
            _, scene, branch, name = key.split("/")
            value = {"eps_lane": eps.lanes, "eps_agent": eps.agents}[name][
                names.index(scene) + BRANCHES.index(branch) * len(names)
            ]
            assert golden.relative(value[: len(expected[key])], expected[key], key) < TOLERANCE, key
            assert not np.any(value[len(expected[key]) :]), f"{key}: padding must be zero"


def test_depth_resized_parity(parity_dir):
    inputs, expected = (golden.load(parity_dir, f"denoiser_{part}.npz") for part in ("inputs", "image"))
    condition = golden.denoiser_config(parity_dir, "image").condition
    for k in range(golden.scenes(inputs)):
        resized = expected[f"s{k}/depth_resized"]
        assert resized.shape == tuple(condition.patch * cells for cells in condition.grid)
        value = depth_cells(jnp.asarray(inputs[f"s{k}/depth"])[None], resized.shape, 1)
        assert golden.relative(value.reshape(resized.shape), resized) < TOLERANCE
