"""What a denoiser reads besides scenes in its training: captions, or pictures of the windows ahead of the ego."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from scjax.data.loader import TrainingExample
from scjax.data.window_images import RaycastImages, StoredImages, WindowImages
from scjax.generate.conditions import Condition, Stream
from scjax.models.denoiser.context import ConditionFeatures, ImageFeatures, TextFeatures
from scjax.scene import Crop


def window_images(config) -> WindowImages | None:
    """What a camera sees in the training windows, where the network reads images."""
    if config.condition != "image":
        return None
    return StoredImages(config.images, "train") if config.images else RaycastImages()


def condition_features(batch: TrainingExample) -> ConditionFeatures | None:
    """What the network reads besides scenes; None: nothing."""
    if batch.tokens is not None and batch.token_mask is not None:
        return TextFeatures(tokens=jnp.asarray(batch.tokens, jnp.float32), mask=batch.token_mask)
    if batch.image is not None and batch.depth is not None:
        return ImageFeatures(dino=batch.image, depth=batch.depth, present=batch.has_image, mask=batch.image_mask)
    return None


def condition_of(example: TrainingExample, reads_depth: bool = True) -> Condition:
    """Counts, domain, crop and caption or image of a scene, with the depth of the image if it has any."""
    scene = example.scene
    streams = {}
    if example.tokens is not None and example.token_mask is not None:
        streams["text"] = Stream(np.asarray(example.tokens[example.token_mask], np.float32))
    if example.image is not None and example.depth is not None and example.image_mask is not None:
        masks = np.split(np.asarray(example.image_mask), 2)
        streams["image"] = dataclasses.replace(Stream.from_image(example.image), mask=masks[0])
        if reads_depth and masks[1].any():
            streams["depth"] = dataclasses.replace(Stream.from_depth(example.depth), mask=masks[1])
    return Condition(
        num_lanes=int(scene.num_lanes),
        num_agents=int(scene.num_agents),
        domain=int(scene.domain),
        crop=Crop(int(scene.crop)),
        streams=streams,
    )
