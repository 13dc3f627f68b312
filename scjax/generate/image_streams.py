"""Pictures of conditions as streams: features and depth of cells, with masks and positions."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from scjax.encoders.depth import DepthProvider, NoDepth, depth_tokens
from scjax.encoders.preprocessing import Preprocessing
from scjax.encoders.vision import ImageEncoder, load_image_encoder
from scjax.generate.camera_stream import camera_tokens
from scjax.generate.conditions import Condition, Stream
from scjax.generate.model import Model
from scjax.models.denoiser.config import ImageCondition, TextCondition

ENCODER_VARIABLE = "SCJAX_IMAGE_ENCODER"
"""Environment variable that names the folder of the image encoder."""

DEFAULT_IMAGE_ENCODER = "facebook/dinov2-small"
"""Looked up in the Hugging Face cache where the variable is not set."""

_CURE = "leave it out, or load a model that was trained on pictures (docs/images.md)"


def image_streams(
    conditions: Sequence[Condition], model: Model, encoder: ImageEncoder | None = None
) -> list[Mapping[str, Stream]]:
    """The streams "image", "depth" and, with a camera, "camera" of every condition; none without a picture.

    Each different picture is encoded once.

    Args:
      encoder: by default the one of the folder that ``ENCODER_VARIABLE`` names, or of the Hugging Face cache.

    Raises:
      ValueError: the model reads no pictures, the encoder is not here or not the model's, or depth cannot be had.
    """
    if all(condition.image is None for condition in conditions):
        return [{} for _ in conditions]
    preprocessing = model_preprocessing(model)
    photos = {condition.image.content: condition.image for condition in conditions if condition.image is not None}
    encoder = encoder or load_image_encoder(os.environ.get(ENCODER_VARIABLE) or DEFAULT_IMAGE_ENCODER)
    if encoder.name != model.image_encoder:
        raise ValueError(
            f"Condition.image needs the encoder that this model was trained with, {model.image_encoder}, but the image "
            f"encoder here is {encoder.name}: give the folder of that one by the variable {ENCODER_VARIABLE}"
        )
    features = dict(zip(photos, encoder(list(photos.values()), preprocessing), strict=True))
    streams: list[Mapping[str, Stream]] = []
    for condition in conditions:
        if condition.image is None:
            streams.append({})
            continue
        provider: DepthProvider = condition.depth or NoDepth()
        (depth,) = depth_tokens(provider, [condition.image], preprocessing)
        image = features[condition.image.content]
        own = {"image": Stream.from_cells(image), "depth": Stream.from_cells(depth)}
        if condition.camera is not None:
            rays = camera_tokens(condition.camera, condition.image.size, image.mask, preprocessing)
            own["camera"] = Stream.from_cells(rays)
        streams.append(own)
    return streams


def model_preprocessing(model: Model) -> Preprocessing:
    """How the model lays pictures on its grid.

    Raises:
      ValueError: it reads no pictures.
    """
    network = model.denoiser.config.condition
    if not isinstance(network, ImageCondition):
        reads = "text" if isinstance(network, TextCondition) else "attributes"
        if network is None and not model.denoiser.config.attributes:
            reads = "no streams"
        raise ValueError(f"Condition.image is given, but this model reads {reads} and no pictures: {_CURE}")
    if not model.image_encoder:
        raise ValueError(
            "Condition.image is given, but this model reads features of no image encoder: give Condition.streams of "
            f"the kind that it was trained on, or {_CURE}"
        )
    return Preprocessing("model", *network.grid, keeps_aspect=model.image_keeps_aspect)
