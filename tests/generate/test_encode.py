"""Conditions as network inputs: prompts are encoded once, streams act, and unreadable ones are refused."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.camera.raycast import CLASSES, GRID, render
from scjax.generate.conditions import Condition, Stream
from scjax.generate.encode import encode_conditions
from scjax.generate.text_streams import text_streams
from scjax.models.denoiser.config import ImageCondition, TextCondition
from scjax.nn.functional import flatten, unflatten
from scjax.scene import Crop
from tests.factories.examples import example_scene
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

COUNTS = {"num_lanes": 6, "num_agents": 4, "domain": 0}
AHEAD = {"num_lanes": 5, "num_agents": 4, "domain": 0, "crop": Crop.FORWARD}


@pytest.fixture(scope="module")
def text_model():
    model = tiny_model(TextCondition(Words.width))
    return dataclasses.replace(model, text_encoder=Words.name, prompts={"a road": Words.features("a road")})


@pytest.fixture(scope="module")
def image_model():
    return tiny_model(ImageCondition(len(CLASSES), GRID, patch=1))


def sample(model, conditions, seed=0, **options):
    return scjax.sample(jax.random.key(seed), conditions, model=model, num_steps=3, **options)


def sample_beside(model, condition, **options):
    """The scene of a condition; beside it always one with a negative text, so that all share a program."""
    return sample(model, [condition, Condition(streams=streams_of("a road", "rain"), **COUNTS)], **options)[0]


def streams_of(text, negative=None):
    streams = {"text": Stream(Words.features(text))}
    return streams if negative is None else {**streams, "negative_text": Stream(Words.features(negative))}


def view(seed: int, **changes) -> dict[str, Stream]:
    """The image and depth streams of what lies ahead of the ego in an example scene."""
    features = render(example_scene(seed, agents=10, lanes=8, crop=Crop.FORWARD))._asdict() | changes
    return {"image": Stream.from_image(features["image"]), "depth": Stream.from_depth(features["depth"])}


def with_closed_gates(model):
    """The same model with the adaLN of its cross attention set to zero."""
    leaves = flatten(model.denoiser.params)
    assert any("cross_adaln" in path for path in leaves)
    params = unflatten({path: 0 * leaf if "cross_adaln" in path else leaf for path, leaf in leaves.items()})
    return model.with_component("denoiser", model.denoiser.config, params)


def test_encode_runs_once_for_each_text(text_model):
    encoder = Words()
    conditions = [Condition(prompt="two  cars "), Condition(prompt="two cars", negative_prompt="rain"), Condition()]
    streams = text_streams(conditions, text_model, encoder)
    assert encoder.calls == ["two cars", "rain"]
    np.testing.assert_array_equal(streams[0]["text"].tokens, streams[1]["text"].tokens)
    assert streams[1]["negative_text"].tokens.shape == (1, Words.width) and not streams[2]


def test_encode_keeps_prompts_in_the_conditions(text_model):
    condition = Condition(prompt="a road")
    encode_conditions([condition], text_model)
    assert condition.prompt == "a road" and not condition.streams


def test_encode_needs_no_encoder_for_the_models_prompts(text_model):
    (streams,) = encode_conditions([Condition(prompt="a road")], text_model)
    assert streams["text"].tokens.shape == (2, Words.width)


def test_encode_refuses_a_prompt_without_text_training():
    with pytest.raises(ValueError, match="not trained on text"):
        encode_conditions([Condition(prompt="a road")], tiny_model())


def test_encode_refuses_another_encoder(text_model):
    other = Words()
    other.name = "words-2"
    with pytest.raises(ValueError, match="trained with, words-1, but the text encoder here is words-2"):
        text_streams([Condition(prompt="a street")], text_model, other)


def test_encode_refuses_an_empty_prompt(text_model):
    with pytest.raises(ValueError, match="prompt is empty"):
        encode_conditions([Condition(prompt="  ")], text_model)


def test_encode_warns_of_a_long_prompt(text_model):
    with pytest.warns(UserWarning, match="10000 words is too long"):
        text_streams([Condition(prompt="road " * 10_000)], text_model, Words())


def test_prompt_equals_its_stream(text_model):
    prompt = sample_beside(text_model, Condition(prompt="a road", **COUNTS), guidance=2.0)
    stream = sample_beside(text_model, Condition(streams=streams_of("a road"), **COUNTS), guidance=2.0)
    chex.assert_trees_all_equal(prompt.to_dict(), stream.to_dict())


def test_text_and_negative_text_change_the_scene(text_model):
    plain, other, negative = (
        sample_beside(text_model, Condition(streams=streams, **COUNTS), guidance=2.0)
        for streams in (streams_of("a road"), streams_of("many cars"), streams_of("a road", "many cars"))
    )
    assert not np.allclose(plain.lanes, other.lanes) and not np.allclose(plain.lanes, negative.lanes)
    unguided = sample_beside(text_model, Condition(streams=streams_of("a road"), **COUNTS), guidance=1.0)
    assert not np.allclose(negative.lanes, unguided.lanes)


def test_negative_text_leaves_other_scenes_alone(text_model):
    plain = Condition(streams=streams_of("a road"), **COUNTS)
    negative = Condition(streams=streams_of("a road", "many cars"), **COUNTS)
    alone = sample(text_model, [plain, plain], seed=4, guidance=2.0)[0]
    among = sample(text_model, [plain, negative], seed=4, guidance=2.0)[0]
    chex.assert_trees_all_close(alone.to_dict(), among.to_dict(), atol=2e-3)


def test_masked_text_tokens_are_not_read(text_model):
    tokens = np.random.default_rng(0).normal(size=(5, Words.width)).astype(np.float32)
    padded = np.concatenate([tokens, np.full((2, Words.width), np.nan, np.float32)])
    whole, masked, nothing = (
        sample_beside(text_model, Condition(streams=streams, num_lanes=4, num_agents=3), guidance=2.0)
        for streams in ({"text": Stream(tokens)}, {"text": Stream(padded, mask=np.arange(7) < 5)}, {})
    )
    chex.assert_trees_all_close(masked.lanes, whole.lanes, atol=1e-3)
    assert not np.allclose(whole.lanes, nothing.lanes)


def test_image_changes_the_scene_only_through_open_gates(image_model):
    first, second = Condition(streams=view(0), **AHEAD), Condition(streams=view(1), **AHEAD)
    own, other = sample(image_model, [first, first]), sample(image_model, [second, second])
    assert not np.allclose(own[0].lanes, other[0].lanes)
    closed = with_closed_gates(image_model)
    shut = [sample(closed, [condition, condition]) for condition in (first, second)]
    chex.assert_trees_all_equal(shut[0][0].to_dict(), shut[1][0].to_dict())


def test_depth_changes_the_scene(image_model):
    depth = view(0)["depth"].grid()[0]
    own, nearer = (Condition(streams=view(0, depth=scale * depth), **AHEAD) for scale in (1.0, 0.5))
    one, other = (sample(image_model, [condition, condition])[0] for condition in (own, nearer))
    assert not np.allclose(one.lanes, other.lanes)


def test_image_leaves_other_scenes_alone(image_model):
    without, seen = Condition(**AHEAD), Condition(streams=view(1), **AHEAD)
    alone, among = sample(image_model, [without, without])[0], sample(image_model, [without, seen])[0]
    chex.assert_trees_all_close(alone.to_dict(), among.to_dict(), atol=2e-3)
    plain, guided = (sample(image_model, [without, seen], guidance=scale)[1] for scale in (1.0, 3.0))
    assert not np.allclose(plain.lanes, guided.lanes)


@pytest.mark.parametrize(
    ("network", "streams", "message"),
    [
        (None, {"text": Stream(np.zeros((3, 4)))}, r"\['text'\] is given, but this model is unconditional: leave"),
        (None, view(0), r"\['image'\] is given, but this model is unconditional"),
        (TextCondition(4), view(0), r"\['image'\] is given, but this model reads text and negative_text: leave"),
        (TextCondition(4), {"attributes": Stream(np.zeros((3, 4)))}, r"\['attributes'\] .* reads text"),
        (TextCondition(4), {"text": Stream(np.zeros((3, 6)))}, r"\['text'\] has tokens of width 6, the model takes 4"),
        (ImageCondition(len(CLASSES), GRID, patch=1), {"text": Stream(np.zeros((3, 4)))}, "reads image and depth"),
        (ImageCondition(len(CLASSES), GRID, patch=1), {**view(0), "text": Stream(np.zeros((3, 4)))}, r"\['text'\]"),
        (
            ImageCondition(len(CLASSES), GRID, patch=1),
            view(0, image=np.zeros((3, *GRID), np.float32)),
            r"\(3, 14, 14\), the model takes \(7, 14, 14\)",
        ),
    ],
)
def test_unreadable_streams_are_refused(network, streams, message):
    with pytest.raises(ValueError, match=message):
        sample(tiny_model(network), Condition(streams=streams, **AHEAD))


def test_depths_of_several_sizes_are_refused(image_model):
    large = Condition(streams=view(0, depth=np.zeros((28, 28), np.float32)), **AHEAD)
    with pytest.raises(ValueError, match=r"sizes \[\(14, 14\), \(28, 28\)\]"):
        sample(image_model, [Condition(streams=view(0), **AHEAD), large])
