"""Held-back scenes as examples, with a caption or an image where the objective reads them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.data.caption_features import TextStore
from scjax.data.loader import Bucket, TrainingExample, validation_scenes, with_caption, with_image
from scjax.models.codec import SceneCodec
from scjax.scene import Crop, Scene


def validation_examples(
    records: str, codec: SceneCodec, *, condition: str, bucket: Bucket, text_slots: int
) -> list[TrainingExample]:
    """Held-back scenes of ``records``, cut to ``bucket`` as training scenes are.

    Args:
      condition: "text": centered scenes with their first caption; "image": forward scenes with what a camera sees;
        "none": centered scenes.
      text_slots: largest number of tokens of a caption.
    """
    crop = Crop.FORWARD if condition == "image" else Crop.CENTERED
    scenes = validation_scenes(records, codec, crop=crop, bucket=bucket)
    if condition == "text":
        return first_captions(records, scenes, text_slots)
    return _numbered([with_image(scene) if condition == "image" else TrainingExample(scene=scene) for scene in scenes])


def first_captions(records: str, scenes: Sequence[Scene], text_slots: int) -> list[TrainingExample]:
    """The held-back scenes of ``records``, in record order, each with the first of its captions."""
    store = TextStore(records, "val")
    slots = store.slots(text_slots)
    return _numbered(
        [with_caption(scene, store.features(int(store.texts_of(row)[0])), slots) for row, scene in enumerate(scenes)]
    )


def _numbered(examples: list[TrainingExample]) -> list[TrainingExample]:
    return [example.replace(index=np.asarray(row, np.uint32)) for row, example in enumerate(examples)]
