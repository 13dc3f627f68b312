"""``Condition`` and ``Stream``: what they refuse, and what a grid survives."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.generate.conditions import Condition, Stream
from scjax.scene import Crop
from tests.factories.examples import example_batch

TEXT = Stream(np.zeros((3, 4), np.float32))
IMAGE = Stream.from_image(np.zeros((7, 2, 3), np.float32))
DEPTH = Stream.from_depth(np.zeros((4, 6), np.float32))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"num_lanes": 0}, r"num_lanes must be a whole number in 1\.\.4096, not 0"),
        ({"num_agents": -3}, "num_agents"),
        ({"known": example_batch(1)}, "single scene"),
        ({"streams": {"sound": TEXT}}, "no 'sound': choose from text"),
        ({"streams": {"text": TEXT}, "prompt": "a road"}, r"\['text'\] and prompt are both given: leave one"),
        ({"streams": {"negative_text": TEXT}, "negative_prompt": "rain"}, "and negative_prompt are both given"),
        ({"streams": {"depth": DEPTH}, "crop": Crop.FORWARD}, "depth is given without an image"),
        ({"streams": {"image": IMAGE, "depth": DEPTH}, "crop": Crop.CENTERED}, r"is CENTERED: leave crop out"),
    ],
)
def test_condition_refuses_bad_fields(fields, message):
    with pytest.raises(ValueError, match=message):
        Condition(**fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"tokens": np.zeros(3)}, "must be .tokens, width., at least one of each"),
        ({"tokens": np.zeros((3, 4)), "mask": np.ones(2, bool)}, r"mask has shape \(2,\), but there are 3 tokens"),
        ({"tokens": np.zeros((3, 4)), "positions": np.zeros((2, 2))}, r"positions has shape \(2, 2\)"),
        (
            {"tokens": np.zeros((3, 4)), "views": np.zeros((1, 3, 4))},
            r"views has shape \(1, 3, 4\), but must be \(5, 3, 4",
        ),
    ],
)
def test_stream_refuses_bad_shapes(fields, message):
    with pytest.raises(ValueError, match=message):
        Stream(**fields)


def test_stream_constructors_refuse_other_ranks():
    with pytest.raises(ValueError, match=r"\[channels, rows, columns\], not of shape \(14, 14\)"):
        Stream.from_image(np.zeros((14, 14)))
    with pytest.raises(ValueError, match=r"\[height, width\], not of shape \(14,\)"):
        Stream.from_depth(np.zeros(14))


def test_stream_grid_is_the_inverse_of_from_image():
    features = np.random.default_rng(0).normal(size=(7, 2, 3)).astype(np.float32)
    np.testing.assert_array_equal(Stream.from_image(features).grid(), features)
    depth = np.random.default_rng(1).uniform(size=(4, 6)).astype(np.float32)
    np.testing.assert_array_equal(Stream.from_depth(depth).grid()[0], depth)


def test_stream_without_positions_has_no_grid():
    with pytest.raises(ValueError, match="no grid"):
        TEXT.grid()
    with pytest.raises(ValueError, match="no full grid"):
        Stream(np.zeros((2, 1)), positions=np.array([[0, 0], [1, 1]])).grid()


def test_stream_hash_depends_on_content_only():
    assert TEXT.content_hash() == Stream(np.zeros((3, 4), np.float32)).content_hash()
    views = np.zeros((5, 3, 4), np.float32)
    masked, viewed = Stream(TEXT.tokens, mask=np.arange(3) < 2), Stream(TEXT.tokens, views=views)
    others = (Stream(np.ones((3, 4), np.float32)), masked, viewed, IMAGE)
    assert len({TEXT.content_hash(), *(other.content_hash() for other in others)}) == 5


def test_streams_combine_freely():
    streams = {"text": TEXT, "negative_text": TEXT, "image": IMAGE, "depth": DEPTH, "attributes": TEXT}
    assert Condition(streams=streams, crop=Crop.FORWARD).streams == streams
    assert Condition(streams={"image": IMAGE, "depth": DEPTH}, crop=Crop.FORWARD, prompt="a road").prompt == "a road"
