"""A tiny model that reads requests and pictures, and features of pictures."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.generate.conditions import Stream
from scjax.generate.model import Model
from scjax.language.attributes.vector import feature_names
from scjax.models.denoiser.config import ImageCondition
from scjax.models.denoiser.model import denoiser
from scjax.nn.functional import flatten, unflatten
from tests.factories.worlds import tiny_model

CHANNELS, GRID = 16, (4, 3)


def picture_model(**changes) -> Model:
    """A model of random parameters whose network has ``attributes`` and an ``ImageCondition``, both."""
    model = tiny_model(ImageCondition(CHANNELS, GRID, patch=1), attributes=feature_names())
    return dataclasses.replace(model, reads_prompts=True, **changes)


def without_pictures(model: Model) -> Model:
    """The model with the same parameters, but for those that read pictures."""
    config = dataclasses.replace(model.denoiser.config, condition=None)
    shapes, params = flatten(denoiser(config).shapes()), flatten(model.denoiser.params)
    return model.with_component("denoiser", config, unflatten({path: params[path] for path in shapes}))


def feature_streams(seed: int, mask: np.ndarray | None = None) -> dict[str, Stream]:
    """Streams of a picture and its depth, of random numbers."""
    rng = np.random.default_rng(seed)
    image = Stream.from_image(rng.normal(size=(CHANNELS, *GRID)).astype(np.float32))
    depth = Stream.from_depth(rng.uniform(size=GRID).astype(np.float32))
    return {name: dataclasses.replace(one, mask=mask) for name, one in (("image", image), ("depth", depth))}
