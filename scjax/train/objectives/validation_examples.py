"""Held-back scenes as examples, with a caption, a request or an image where the objective reads them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from scjax.data.caption_features import TextStore
from scjax.data.loader import Bucket, TrainingExample, validation_scenes, with_caption, with_image
from scjax.data.measurements import MeasuredRecords
from scjax.data.window_images import WindowImages
from scjax.language.attributes.draw import draw_attributes
from scjax.language.attributes.vector import feature_names, request_vector
from scjax.models.codec import SceneCodec
from scjax.scene import Crop, Scene

_SEED = 5  # of the requests


def validation_examples(
    records: str,
    codec: SceneCodec,
    *,
    condition: str,
    attributes: bool = False,
    images: WindowImages | None = None,
    bucket: Bucket,
    text_slots: int,
) -> list[TrainingExample]:
    """Held-back scenes of ``records``, cut to ``bucket`` as training scenes are.

    Args:
      condition: "text": centered scenes with their first caption; "image": forward scenes with what a camera sees, of
        ``images``; "none": centered scenes.
      attributes: whether examples carry a request as well, the same at every call; forward scenes carry none.
      text_slots: largest number of tokens of a caption.
    """
    crop = Crop.FORWARD if condition == "image" else Crop.CENTERED
    scenes = validation_scenes(records, codec, crop=crop, bucket=bucket)
    if condition == "text":
        examples = first_captions(records, scenes, text_slots)
    else:
        examples = [
            TrainingExample(scene=scene) if images is None else with_image(scene, row, images)
            for row, scene in enumerate(scenes)
        ]
    if attributes:
        requests = [{}] * len(examples) if crop == Crop.FORWARD else validation_requests(records)
        examples = [
            example.replace(attributes=request_vector(request, feature_names()))
            for example, request in zip(examples, requests, strict=True)
        ]
    return _numbered(examples)


def validation_requests(records: str) -> list[dict[str, Any]]:
    """A request for every held-back scene of ``records``, which the scene fulfills; the same at every call."""
    measured = MeasuredRecords(records, "val")
    return [draw_attributes(measured[row], np.random.default_rng([_SEED, row])) for row in range(len(measured))]


def first_captions(records: str, scenes: Sequence[Scene], text_slots: int) -> list[TrainingExample]:
    """The held-back scenes of ``records``, in record order, each with the first of its captions."""
    store = TextStore(records, "val")
    slots = store.slots(text_slots)
    return _numbered(
        [with_caption(scene, store.features(int(store.texts_of(row)[0])), slots) for row, scene in enumerate(scenes)]
    )


def _numbered(examples: list[TrainingExample]) -> list[TrainingExample]:
    return [example.replace(index=np.asarray(row, np.uint32)) for row, example in enumerate(examples)]
