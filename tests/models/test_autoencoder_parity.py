"""The official preset against golden vectors of the official autoencoder: every array, gradient and loss term.

(In one padded batch; that a scene alone gives the same is a test of test_autoencoder.py.)
"""

from __future__ import annotations

import functools

import jax
import numpy as np
import pytest

from scjax.convert.autoencoder import aliases, from_official, to_official, unused_sizes
from scjax.models.autoencoder import autoencoder
from scjax.models.autoencoder.blocks import GraphAttention
from scjax.models.autoencoder.edges import DenseEdges
from scjax.models.autoencoder.loss import loss, scene_losses
from scjax.models.codec import NormalizedScene
from scjax.nn.functional import functional
from scjax.scene.per_type import PerType
from tests.factories import parity_scenes as cases


@pytest.fixture(scope="module")
def config(parity_dir):
    return cases.autoencoder_config(parity_dir)


@pytest.fixture(scope="module")
def weights(parity_dir):
    return cases.load(parity_dir, "ae_weights.npz")


@pytest.fixture(scope="module")
def params(weights, config):
    return from_official(weights, config)


@pytest.fixture(scope="module")
def inputs(parity_dir):
    return cases.load(parity_dir, "ae_inputs.npz")


@pytest.fixture(scope="module")
def run(config, params):
    """Everything that the set knows of a batch, from one program."""
    apply = autoencoder(config).apply

    def total(params, tokens, noise):
        posterior, decoded = apply(params, tokens, noise, method="reconstruct")
        value, means = loss(decoded, posterior, tokens)
        return value, (means, scene_losses(decoded, posterior, tokens))

    def everything(params, tokens, latents, noise):
        arrays = _arrays(*apply(params, tokens, latents, method="trace"))
        (_, terms), gradient = jax.value_and_grad(total, has_aux=True)(params, tokens, noise)
        return arrays, terms, gradient

    # Compiling is all that takes time here: leave the code as it comes.
    # The compiler would compute with parameters that are no arguments.
    return functools.partial(jax.jit(everything, compiler_options={"xla_backend_optimization_level": 0}), params)


@pytest.fixture(scope="module")
def together(run, inputs):
    """All scenes in one batch, the largest with two rows of padding, and garbage in all padding."""
    return jax.device_get(run(*_batch(inputs, cases.scene_names(inputs), garbage=1e30)))


def _batch(inputs, names, garbage) -> tuple[NormalizedScene, PerType, PerType]:
    """Tokens, latents for the decoder, noise."""
    tokens = [cases.tokens_of(inputs, name) for name in names]
    sizes = (max(s.agent_mask.shape[1] for s in tokens) + 2, max(s.lane_mask.shape[1] for s in tokens) + 2)
    latents, noise = (
        [cases.padded_nodes(cases.nodes_of(inputs, name, kind), *sizes, garbage) for name in names]
        for kind in ("decode_z", "noise")
    )
    tokens = cases.concatenate(*(cases.padded(scene, *sizes, garbage) for scene in tokens))
    return tokens, cases.concatenate(*latents), cases.concatenate(*noise)


def _arrays(posterior, decoded, trace) -> dict[str, jax.Array]:
    """Everything under the set's names; pairs (source, destination) as there."""
    from_name = {name: x.swapaxes(1, 2) if name.endswith("edge") else x for name, x in trace.items()}
    from_name |= {
        "enc/lane_mu": posterior.mean.lanes,
        "enc/lane_logvar": posterior.logvar.lanes,
        "enc/agent_mu": posterior.mean.agents,
        "enc/agent_logvar": posterior.logvar.agents,
        "enc/lane_count_logits": posterior.lane_count_logits,
        "enc/lane_count_prob": jax.nn.softmax(posterior.lane_count_logits),
        "dec/agent_states": decoded.agents,
        "dec/lane_points": decoded.lanes,
        "dec/agent_type_logits": decoded.agent_type_logits,
        "dec/lane_type_logits": decoded.lane_type_logits,
        "dec/lane_connection_logits": decoded.link_logits,
        "dec/agent_type": decoded.agent_type_logits.argmax(-1),
        "dec/lane_type": decoded.lane_type_logits.argmax(-1),
        "dec/lane_connection": decoded.link_logits.argmax(-1),
    }
    return from_name


def _compare(result: dict[str, np.ndarray], outputs, inputs, scene: str, row: int) -> int:
    same_side = inputs[f"{scene}/lane_lane_same_side"][..., None]
    expected = {name.split("/", 1)[1]: x for name, x in outputs.items() if name.startswith(f"{scene}/")}
    # The never-used edges after the last encoder block are not computed here.
    last = max(name for name in expected if name.startswith("enc/block")).split("/")[1]
    expected.pop(f"enc/{last}/edge", None)
    assert expected.keys() <= result.keys(), sorted(expected.keys() - result.keys())
    for name, reference in expected.items():
        value = result[name][row][tuple(slice(n) for n in reference.shape)]
        if name.startswith("enc/") and name.endswith("edge"):
            value = np.where(same_side, value, 0)
        if reference.dtype == np.int32:
            np.testing.assert_array_equal(value, reference, err_msg=f"{scene}/{name}")
        else:
            tolerance = 2e-5 if name.endswith("edge") else 1e-5
            np.testing.assert_allclose(value, reference, tolerance, tolerance, err_msg=f"{scene}/{name}")
    return len(expected)


def test_forward_parity_in_one_padded_batch(parity_dir, inputs, together):
    outputs, names = cases.load(parity_dir, "ae_outputs.npz"), cases.scene_names(inputs)
    compared = sum(_compare(together[0], outputs, inputs, name, row) for row, name in enumerate(names))
    assert compared == len(outputs) - len(names)  # all but the edges after the last encoder block


def test_partition_masks_parity(inputs):
    """The sides that NormalizedScene carry give the set's masks."""
    for scene in cases.scene_names(inputs):
        tokens = cases.tokens_of(inputs, scene)
        for name, rows, columns in (
            ("lane_lane", tokens.lane_behind, tokens.lane_behind),
            ("agent_agent", tokens.agent_behind, tokens.agent_behind),
            ("lane_agent", tokens.lane_behind, tokens.agent_behind),
        ):
            expected = inputs[f"{scene}/{name}_same_side"]
            np.testing.assert_array_equal(rows[0][:, None] == columns[0][None], expected, err_msg=f"{scene} {name}")


def test_loss_parity(parity_dir, together):
    reference = cases.load(parity_dir, "ae_loss.npz")
    means, scenes = together[1]
    renamed = {"lane_count_over_nonzero_types": "lane_count_over_counted"}
    for name, expected in reference.items():
        kind, term = name.split("/")
        result = scenes[term] if kind == "per_scene" else means[renamed.get(term, term)]
        np.testing.assert_allclose(result, expected, 1e-5, 1e-5, err_msg=name)


def test_gradient_parity(parity_dir, config, together):
    reference = cases.load(parity_dir, "ae_grads.npz")
    result = to_official(together[2], config)
    unused = unused_sizes(config)
    for key, expected in reference.items():
        if key in unused:
            assert not expected.any() and key not in result, key
        else:
            worst, bound = np.abs(result[key] - expected).max(), 1e-4 * np.linalg.norm(expected) + 1e-7
            assert worst <= bound, f"{key}: {worst} > {bound}"
    assert result.keys() | unused.keys() == set(reference)


@pytest.mark.parametrize("kind", ["edge", "plain"])
def test_attention_layer_parity(parity_dir, config, params, kind):
    known = cases.load(parity_dir, "ae_attention_inputs.npz")
    reference = cases.load(parity_dir, "ae_attention_outputs.npz")
    if kind == "edge":
        sizes, edge_width = (config.lane_width, config.lane_heads, config.lane_ff), config.edge_width
        layer = params["encoder"]["blocks"][0]["lane_lane"]
    else:
        sizes, edge_width = (config.agent_width, config.agent_heads, config.agent_ff), None
        layer = params["decoder"]["blocks"][1]["agent_agent"]
    network = functional(lambda init: GraphAttention(*sizes, init=init, edge_width=edge_width, compute="float32"))

    @jax.jit
    def run(layer, x, mask, r):
        trace: dict = {}
        network.apply(layer, x, mask, edges=None if r is None else DenseEdges(r), trace=trace)
        return trace

    r = known["edge/r"].swapaxes(0, 1)[None] if kind == "edge" else None
    result = run(layer, known[f"{kind}/x"][None], known[f"{kind}/mask"].T[None], r)
    expected = {name.split("/")[1]: x for name, x in reference.items() if name.startswith(f"{kind}/")}
    assert expected.keys() <= result.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(result[name][0], value, 1e-5, 1e-5, err_msg=f"{kind}/{name}")


def test_state_dict_parity(weights, config, params):
    """The converter takes every official key and gives each back."""
    back = to_official(params, config)
    extra = weights.keys() - back.keys()
    assert extra == unused_sizes(config).keys() | aliases(config).keys()
    for key, value in back.items():
        np.testing.assert_array_equal(value, weights[key], err_msg=key)
    for key, size in unused_sizes(config).items():
        assert weights[key].size == size, key
