"""Images as conditions of sampling: read where the gates let them, absent ones leave no trace, mistakes are told."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.camera.raycast import CLASSES, GRID, render
from scjax.generate.conditions import Condition
from scjax.models.denoiser.config import ImageCondition, TextCondition
from scjax.nn.functional import flatten, unflatten
from scjax.scene import Crop
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model

READS = ImageCondition(len(CLASSES), GRID, patch=1)
FIXED = {"num_lanes": 5, "num_agents": 4, "domain": 0, "crop": Crop.FORWARD}


def seen(seed: int) -> Condition:
    features = render(example_scene(seed, agents=10, lanes=8, crop=Crop.FORWARD))
    return Condition(image=features.image, depth=features.depth, **FIXED)


def draw(model, *conditions, **options):
    return scjax.sample_many(jax.random.key(0), conditions, model=model, steps=3, **options)


@pytest.fixture(scope="module")
def model():
    return tiny_model(READS)


def closed(model):
    """The same model behind gates that are zero."""
    leaves = flatten(model.denoiser.params)
    assert any("cross_adaln" in path for path in leaves)
    params = unflatten({path: 0 * leaf if "cross_adaln" in path else leaf for path, leaf in leaves.items()})
    return model.with_component("denoiser", model.denoiser.config, params)


def test_another_image_is_another_scene_only_through_open_gates(model):
    own, other = draw(model, seen(0), seen(0)), draw(model, seen(1), seen(1))
    assert not np.allclose(own[0].lanes, other[0].lanes)
    shut = [draw(closed(model), condition, condition) for condition in (seen(0), seen(1))]
    chex.assert_trees_all_equal(shut[0][0].to_dict(), shut[1][0].to_dict())


def test_depth_is_read_too(model):
    condition = seen(0)
    nearer = dataclasses.replace(condition, depth=0.5 * condition.depth)
    assert not np.allclose(draw(model, condition)[0].lanes, draw(model, nearer)[0].lanes)


def test_scenes_without_an_image_are_not_touched_by_others(model):
    without = Condition(**FIXED)
    alone, among = draw(model, without, without)[0], draw(model, without, seen(1))[0]
    chex.assert_trees_all_close(alone.to_dict(), among.to_dict(), atol=2e-3)
    plain, guided = (draw(model, without, seen(1), guidance=weight)[1] for weight in (1.0, 3.0))
    assert not np.allclose(plain.lanes, guided.lanes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"crop": Crop.CENTERED}, r"layout is CENTRED: give layout=Layout\.FORWARD"),
        ({"depth": None}, "belong together"),
        ({"image": np.zeros((14, 14))}, r"\[channels, rows, columns\], not of shape \(14, 14\)"),
        ({"depth": np.zeros(14)}, r"\[height, width\], not of shape \(14,\)"),
        ({"prompt": "a road"}, "leave one out"),
    ],
)
def test_bad_conditions(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(seen(0), **change)


def test_conditions_that_a_model_does_not_read(model):
    narrow = dataclasses.replace(seen(0), image=np.zeros((3, *GRID), np.float32))
    with pytest.raises(ValueError, match=r"\(3, 14, 14\), the model takes \(7, 14, 14\)"):
        draw(model, narrow)
    large = dataclasses.replace(seen(0), depth=np.zeros((28, 28), np.float32))
    with pytest.raises(ValueError, match=r"sizes \[\(14, 14\), \(28, 28\)\]"):
        draw(model, seen(0), large)
    with pytest.raises(ValueError, match=r"Condition\.tokens is given, but this model reads images"):
        draw(model, Condition(tokens=np.zeros((3, 4), np.float32)))
    with pytest.raises(ValueError, match=r"Condition\.image is given, but this model reads texts"):
        draw(tiny_model(TextCondition(4)), seen(0))
    with pytest.raises(ValueError, match=r"Condition\.image is given, but this model is unconditional"):
        draw(tiny_model(), seen(0))
