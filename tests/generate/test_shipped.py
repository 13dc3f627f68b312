"""The model in the package: complete, of the synthetic world alone, within its bounds."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import scjax
from scjax.cli.demo import PROMPTS
from scjax.data import records
from scjax.data.token_order import sort_tokens
from scjax.diffusion.log_snr_schedule import log_snr_schedule
from scjax.diffusion.process import estimate_x0, q_sample
from scjax.generate.conditions import Condition
from scjax.generate.model import DEFAULT_MODEL
from scjax.generate.prompt_reader import DEFAULT_READER
from scjax.generate.readings import read_prompts, reads_requests
from scjax.language.attributes.vector import request_vector
from scjax.models.autoencoder.model import autoencoder
from scjax.models.denoiser.model import denoiser
from scjax.scene import Crop, stack
from scjax.scene.per_type import PerType
from scjax.synthetic.domains import DOMAINS


@pytest.fixture(scope="module")
def model():
    return scjax.load()


def test_files_stay_small():
    sizes = [path.stat().st_size / 1e6 for path in DEFAULT_MODEL.iterdir()]
    assert max(sizes) <= 16 and sum(sizes) <= 60


def test_every_part_is_there_and_finite(model):
    for name in ("autoencoder", "denoiser", "count_predictor"):
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(model.components[name].params))
    assert model.counts is not None and model.outlines is not None and len(model.outlines) == 8000


def test_it_knows_the_synthetic_world_alone_and_says_so(model):
    assert set(model.domains) <= {domain.name for domain in DOMAINS}
    assert model.notes["data"] == "the synthetic world of scjax, nothing else"
    assert (DEFAULT_MODEL / "README.md").is_file()


def test_rounded_products_hardly_change_what_a_step_estimates(model, world_records):
    """bfloat16 operands, at all levels of noise: what the network returns, and the clean latents that this means."""
    coder, config = autoencoder(model.autoencoder.config), model.denoiser.config
    tiles = records.open_records(world_records, "train")
    scenes = [sort_tokens(records.sample_scene(records.decode_record(tile), Crop.CENTERED))[0] for tile in tiles]
    scenes = [scene for scene in scenes if scene.num_agents <= 16 and scene.num_lanes <= 28][:3]
    tokens = model.codec.normalize(stack(scenes, (16, 28)))
    clean = jax.jit(lambda params: coder.apply(params, tokens, method="encode").mean)(model.autoencoder.params)

    # Every scene at every time, in one batch.
    times = np.array([0, 2, 10, 30, 60, 99])
    row, step = (part.ravel() for part in np.meshgrid(np.arange(len(scenes)), times))
    masks = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
    clean, masks = jax.tree.map(lambda x: jnp.asarray(x)[row], (model.latents.normalize(clean), masks))
    rng, level = np.random.default_rng(0), log_snr_schedule().levels[step]
    noisy = q_sample(level, clean, jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), clean))
    requests = read_prompts([Condition(prompt=prompt) for prompt in PROMPTS], model).conditions
    attributes = np.stack([request_vector(one.attributes, config.attributes) for one in requests])
    attributes = jnp.asarray(attributes[row % len(PROMPTS)])
    label = jnp.zeros(len(row), jnp.int32)

    @functools.partial(jax.jit, static_argnums=0)
    def estimates(compute, params):
        network = denoiser(dataclasses.replace(config, compute=compute))
        output = network.apply(params, noisy, level.time, label, masks, attributes=attributes)
        both = output, estimate_x0(level, noisy, output, config.prediction)
        return jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), both, (masks, masks))

    def squares(x: PerType) -> np.ndarray:
        return np.stack(
            [sum(np.square(np.asarray(part)[step == time]).sum() for part in jax.tree.leaves(x)) for time in times]
        )

    exact, rounded = (estimates(compute, model.denoiser.params) for compute in ("float32", "bfloat16"))
    for one, other, most in zip(exact, rounded, (0.04, 0.02), strict=True):  # the output, and the clean latents
        error = np.sqrt(squares(jax.tree.map(np.subtract, one, other)) / squares(one))
        assert (error > 0).all() and (error < most).all(), error


def test_what_the_demo_prompts_ask_for_ships_with_the_reader(model, monkeypatch):
    """So the demo reads its prompts without an encoder."""
    monkeypatch.setattr("scjax.generate.prompt_reader.load_text_encoder", None)
    read = read_prompts([Condition(prompt=prompt) for prompt in PROMPTS], model).conditions
    assert reads_requests(model) and [one.attributes.get("layout") for one in read[:5]] == [
        *("four-way", "T", "straight", "curve", "roundabout")
    ]
    assert read[0].attributes["signal"] == "red" and read[5].attributes["event"] == ("wrong-way",)
    assert sum(path.stat().st_size / 1e6 for path in DEFAULT_READER.iterdir()) < 10
    assert (DEFAULT_READER / "README.md").is_file()
