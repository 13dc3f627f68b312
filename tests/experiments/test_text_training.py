"""Prompts end to end: an unconditional base, its condition blocks on captions, counts; then scenes for a prompt."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

import scjax
from experiments.train import train
from scjax.data.build import build
from scjax.data.captions.embeddings import embed_captions
from scjax.data.captions.store import add_captions
from scjax.data.sources import BuildOptions
from scjax.data.synthetic.source import Worlds
from scjax.nn.control.windowed import WindowedOptions
from scjax.nn.functional import flatten
from tests.experiments.smallest import get_config
from tests.test_prompts import Words
from tests.worlds import tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Captioned and embedded records, and models of both stages before text."""
    folder = tmp_path_factory.mktemp("text")
    build(Worlds(3, 6), folder / "records", BuildOptions(split_percent=30.0))
    add_captions(folder / "records", paraphrases=1, progress=False)
    embed_captions(folder / "records", Words(), progress=False)
    config = configured("denoiser", folder)
    model = dataclasses.replace(tiny_model(), domains=("city", "suburb"))
    scjax.save(dataclasses.replace(model, denoiser=None, denoiser_config=None), folder / "autoencoder")
    train(config, folder / "base")
    return folder


def configured(stage: str, folder):
    config = get_config(stage)
    config.records = str(folder / "records")
    config.steps, config.evaluate_every, config.picture_every, config.checkpoint_every = 3, 3, 0, 3
    if stage == "denoiser":
        config.autoencoder = str(folder / "autoencoder")
    return config


@pytest.fixture(scope="module")
def text_model(folder):
    config = configured("denoiser", folder)
    config.condition, config.start, config.freeze = "text", str(folder / "base" / "model"), True
    config.loss.collision = 0.1
    config.control, config.control_options.windowed.window = "windowed", 4
    train(config, folder / "text")
    return scjax.load(folder / "text" / "model")


def test_frozen_parameters_stay_and_the_others_learn(folder, text_model):
    base = flatten(scjax.load(folder / "base" / "model").denoiser)
    text = flatten(text_model.denoiser)
    assert all(np.array_equal(text[path], value) for path, value in base.items())
    assert any("context" in path for path in text.keys() - base.keys())
    assert text_model.text_encoder == "words-1"
    assert text_model.denoiser_config.control == WindowedOptions(window=4)


def test_a_prompt_decides_counts_and_scene(folder, text_model):
    config = configured("counter", folder)
    config.denoiser = str(folder / "text" / "model")
    train(config, folder / "prompt")
    model = scjax.load(folder / "prompt" / "model")
    assert model.counter_config is not None and model.counter_config.text_width == Words.width
    tokens = Words()(["a straight road"])[0].features
    scene = scjax.sample(jax.random.key(0), scjax.Condition(tokens=tokens), model=model, steps=2)[0]
    scjax.validate(scene)


def test_mistakes_are_told(folder):
    config = configured("denoiser", folder)
    config.freeze = True
    with pytest.raises(ValueError, match=r"name its folder in config\.start"):
        train(config, folder / "no start")
    config.freeze, config.condition = False, "smell"
    with pytest.raises(ValueError, match='choose "none" or "text"'):
        train(config, folder / "smell")
    config.condition, config.control = "none", "windowd"
    with pytest.raises(ValueError, match="did you mean 'windowed'"):
        train(config, folder / "windowd")
    config.control, config.start = "full", str(folder / "autoencoder")
    with pytest.raises(ValueError, match="holds no denoiser"):
        train(config, folder / "no denoiser")
    config = configured("counter", folder)
    config.denoiser = str(folder / "base" / "model")
    with pytest.raises(ValueError, match="was trained on no text"):
        train(config, folder / "no text")
