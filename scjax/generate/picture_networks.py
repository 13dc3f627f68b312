"""Which networks make streams of a picture, where none are given: the model's own, if they are here."""

from __future__ import annotations

import os
from pathlib import Path

from scjax.encoders.base import CONFIG_FILE
from scjax.encoders.depth import DEPTH_NETWORKS, DepthProvider, NoDepth, load_depth_network
from scjax.encoders.vision import ImageEncoder, load_image_encoder
from scjax.encoders.weights import read_json_object
from scjax.generate.model import Model

ENCODER_VARIABLE = "SCJAX_IMAGE_ENCODER"
"""Environment variable that names the folder of the image encoder; it comes before all others."""

EMBEDDED_VISION = Path(__file__).parents[1] / "pretrained_vision"
"""Folder of the image encoder and depth network that ship with the package."""

DEFAULT_IMAGE_ENCODER = "facebook/dinov2-small"
"""Looked up in the Hugging Face cache for models of another encoder, where the variable is not set."""


def default_image_encoder(model: Model) -> ImageEncoder:
    """The encoder of the variable, else the embedded one if it is the model's, else that of the Hugging Face cache.

    Raises:
      ValueError: it is not here or damaged; names the cure.
    """
    source = os.environ.get(ENCODER_VARIABLE)
    if not source:
        source = EMBEDDED_VISION if _is_embedded(model.image_encoder) else DEFAULT_IMAGE_ENCODER
    return load_image_encoder(source)


def check_encoder(encoder: ImageEncoder, model: Model) -> None:
    """Checks that an encoder is the one that the model was trained with.

    Raises:
      ValueError: it is another one; names both and the cure.
    """
    if encoder.name != model.image_encoder:
        raise ValueError(
            f"Condition.image needs the encoder that this model was trained with, {model.image_encoder}, but the image "
            f"encoder here is {encoder.name}: give the folder of that one by the variable {ENCODER_VARIABLE}"
        )


def default_depth(model: Model) -> DepthProvider:
    """Where depth comes from that is not given: the embedded network, for models that were trained on such depth.

    Raises:
      ValueError: the embedded folder is damaged.
    """
    has_network = model.estimates_depth and _embedded_type() in DEPTH_NETWORKS
    return load_depth_network(EMBEDDED_VISION) if has_network else NoDepth()


def _is_embedded(name: str) -> bool:
    """Whether an encoder of this name may be the embedded one, by its type; its weights decide in the end."""
    kind = _embedded_type()
    return bool(kind) and name.startswith(f"{kind}-")


def _embedded_type() -> str:
    """``model_type`` of the embedded networks; "" where there are none."""
    path = EMBEDDED_VISION / CONFIG_FILE
    return str(read_json_object(path).get("model_type", "")) if path.is_file() else ""
