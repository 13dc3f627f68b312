"""Requests and losses of the ablation: scenes that fit, shuffled conditions, padding."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import scjax
from experiments.studies.ablation.denoising import denoising_losses
from experiments.studies.ablation.requests import make_requests, pad_texts
from scjax.camera.raycast import CLASSES, GRID, render
from scjax.models.denoiser.config import ImageCondition
from scjax.scene import Crop
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def records(captioned_records):
    return str(captioned_records)


def text_requests(records, lanes):
    return make_requests("text", records, 99, tiny_model(), (61, lanes))


def test_make_requests_skips_scenes_larger_than_the_bucket(records):
    every = text_requests(records, 100)
    lanes = sorted(int(scene.num_lanes) for scene in every.references)
    small = text_requests(records, lanes[-1] - 1)
    assert max(int(scene.num_lanes) for scene in small.references) < lanes[-1]
    assert len(small.references) == sum(number < lanes[-1] for number in lanes) < len(every.references)
    sizes = {len(field) for field in (small.own, small.shuffled, small.requests, small.clusters, small.references)}
    assert len(sizes) == 1


def test_make_requests_needs_a_scene_that_fits(records):
    with pytest.raises(ValueError, match=r"none of .* has at most"):
        text_requests(records, 0)


def test_image_requests_are_forward_with_shuffled_images(records):
    requests = make_requests("image", records, 4, tiny_model())
    for scene, own, shuffled in zip(requests.references, requests.own, requests.shuffled, strict=True):
        assert own.crop == Crop.FORWARD and int(scene.crop) == Crop.FORWARD
        image = own.streams["image"]
        np.testing.assert_array_equal(image.grid(), render(scene).image)
        counts = [(one.num_lanes, one.num_agents, one.domain) for one in (own, shuffled)]
        assert counts[0] == counts[1]
        assert not np.array_equal(image.tokens, shuffled.streams["image"].tokens)
    assert not requests.requests and requests.context == 392


def test_pad_texts_masks_the_padding():
    tokens = np.ones((3, 5), np.float32)
    (condition,) = pad_texts([scjax.Condition(streams={"text": scjax.Stream(tokens)})], 8)
    text = condition.streams["text"]
    assert text.tokens.shape == (8, 5) and text.mask.sum() == 3
    np.testing.assert_array_equal(text.tokens[:3], tokens)
    assert not text.tokens[3:].any()


@pytest.fixture(scope="module")
def image_requests(records):
    return make_requests("image", records, 5, tiny_model())


def test_losses_depend_on_scene_and_seed(image_requests):
    scenes = image_requests.references
    plain = [dataclasses.replace(condition, streams={}) for condition in image_requests.own]
    losses = denoising_losses(tiny_model(), scenes, plain, 3)
    assert losses.shape == (len(scenes),) and (losses > 0).all() and len(set(losses)) == len(scenes)
    np.testing.assert_allclose(denoising_losses(tiny_model(), scenes[:1], plain[:1], 3), losses[:1], rtol=1e-5)
    assert not np.isclose(denoising_losses(tiny_model(), scenes[:1], plain[:1], 4), losses[:1]).any()


def test_losses_depend_on_the_condition(image_requests):
    model = tiny_model(condition=ImageCondition(len(CLASSES), GRID, patch=1))
    own, shuffled = (
        denoising_losses(model, image_requests.references, conditions, 5)
        for conditions in (image_requests.own, image_requests.shuffled)
    )
    assert (own != shuffled).all()
