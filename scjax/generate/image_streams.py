"""Pictures of conditions as streams: features and depth of cells, with masks and positions."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from scjax.camera.photo import Photo
from scjax.camera.standard_view import standard_view
from scjax.encoders.dashcam_weights import takes_standard_views
from scjax.encoders.depth import DepthProvider, depth_tokens
from scjax.encoders.preprocessing import Preprocessing
from scjax.encoders.vision import GridTokens, ImageEncoder
from scjax.generate.camera_stream import camera_tokens
from scjax.generate.conditions import Condition, Stream
from scjax.generate.model import Model
from scjax.generate.picture_networks import check_encoder, default_depth, default_image_encoder
from scjax.generate.seen_views import CHANGES, changed_views
from scjax.models.denoiser.config import ImageCondition, TextCondition

_CURE = "leave it out, or load a model that was trained on pictures (docs/images.md)"


def image_streams(
    conditions: Sequence[Condition], model: Model, encoder: ImageEncoder | None = None
) -> list[Mapping[str, Stream]]:
    """The streams "image", "depth" and, with a camera, "camera" of every condition; none without a picture.

    Each different picture is encoded once, and each different depth. The encoder of the package gets standard views of
    the pictures, by ``Condition.camera``, and changed ones of them where seen agents shall hold (``seen_views``).

    Args:
      encoder: by default the model's (``default_image_encoder``).

    Raises:
      ValueError: the model reads no pictures, the encoder is not here or not the model's, or depth cannot be had.
    """
    if all(condition.image is None for condition in conditions):
        return [{} for _ in conditions]
    preprocessing = model_preprocessing(model)
    views = [_encoded_view(condition, model) for condition in conditions]
    photos = {view.content: view for view in views if view is not None}
    if encoder is None:
        encoder = default_image_encoder(model)
    check_encoder(encoder, model)
    network = model.denoiser.config.condition
    reads_depth = isinstance(network, ImageCondition) and network.depth
    features = dict(zip(photos, encoder(list(photos.values()), preprocessing), strict=True))
    seen_views = _seen_views(conditions, views, model, encoder)
    depths: dict[tuple[str, str], GridTokens] = {}
    streams: list[Mapping[str, Stream]] = []
    for condition, view in zip(conditions, views, strict=True):
        photo = condition.image
        if photo is None or view is None:
            streams.append({})
            continue
        image = features[view.content]
        own = {"image": dataclasses.replace(Stream.from_cells(image), views=seen_views.get(view.content))}
        if reads_depth:
            provider: DepthProvider = default_depth(model) if condition.depth is None else condition.depth
            pair = photo.content, provider.key_of(photo)
            if pair not in depths:
                (depths[pair],) = depth_tokens(provider, [photo], preprocessing)
            own["depth"] = Stream.from_cells(depths[pair])
        elif condition.depth is not None:
            warnings.warn("Condition.depth is not read by this model: the features of its encoder say it", stacklevel=5)
        if condition.camera is not None and view is photo:
            own["camera"] = Stream.from_cells(camera_tokens(condition.camera, image.mask, preprocessing))
        streams.append(own)
    return streams


def _seen_views(
    conditions: Sequence[Condition], views: Sequence[Photo | None], model: Model, encoder: ImageEncoder
) -> dict[str, np.ndarray]:
    """Tokens of changed views by the content of the standard view, where seen agents shall hold."""
    if model.views is None or not takes_standard_views(model.image_encoder):
        return {}
    photos = {
        view.content: view
        for condition, view in zip(conditions, views, strict=True)
        if view is not None and condition.hold_seen and condition.known is None
    }
    changed = [other for photo in photos.values() for other in changed_views(photo)]
    tokens = [cells.tokens for cells in encoder(changed, model_preprocessing(model))] if changed else []
    return {content: np.stack(tokens[len(CHANGES) * k : len(CHANGES) * (k + 1)]) for k, content in enumerate(photos)}


def _encoded_view(condition: Condition, model: Model) -> Photo | None:
    """The picture that the encoder gets."""
    if condition.image is None or not takes_standard_views(model.image_encoder):
        return condition.image
    return standard_view(condition.image, condition.camera)


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
