"""Conditions as inputs of the networks: prompts become token streams, and streams become batched features.

This is the only place that knows which streams a network reads.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.encoders.base import TextEncoder
from scjax.encoders.text import load_text_encoder
from scjax.generate.conditions import Condition, Stream
from scjax.generate.image_streams import image_streams
from scjax.generate.model import Model
from scjax.generate.readings import reads_requests
from scjax.language.attributes.request_text import request_text
from scjax.models.denoiser.config import ConditionConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ConditionFeatures, ImageFeatures, TextFeatures

Streams = Mapping[str, Stream]
NetworkInputs = tuple[ConditionFeatures | None, TextFeatures | None]
"""Features of the conditions, and of the negative prompts that guidance leads away from; None where there are none."""


def encode_conditions(
    conditions: Sequence[Condition], model: Model, encoder: TextEncoder | None = None
) -> list[Streams]:
    """The streams of every condition, those of its prompts included; each different text is encoded once.

    Args:
      encoder: the text encoder; by default the one that ``load_text_encoder`` finds. It is needed only for texts that
        are not among ``model.prompts``.

    Raises:
      ValueError: the model cannot read a stream, or the encoder is not the model's.
    """
    by_condition = [_texts(condition, model) for condition in conditions]
    texts = dict.fromkeys(text for one in by_condition for text in one.values())
    features = _encode_texts(list(texts), model, encoder) if texts else {}
    streams: list[Streams] = [
        {**condition.streams, **{name: Stream(features[text]) for name, text in own.items()}}
        for condition, own in zip(conditions, by_condition, strict=True)
    ]
    if any(condition.image is not None for condition in conditions):
        pictures = _without_cameras(image_streams(conditions, model), model.denoiser.config.condition)
        streams = [{**own, **more} for own, more in zip(streams, pictures, strict=True)]
    check_readable(streams, model.denoiser.config.condition)
    return streams


def _without_cameras(streams: Sequence[Streams], condition: ConditionConfig) -> list[Streams]:
    """The streams of pictures, without those of cameras if the network reads none: a picture serves without."""
    if "camera" in _READERS[type(condition)].names or not any("camera" in row for row in streams):
        return list(streams)
    warnings.warn(
        "Condition.camera is not read by this model: the picture counts as one of the cameras that it was trained on",
        stacklevel=5,
    )
    return [{name: stream for name, stream in row.items() if name != "camera"} for row in streams]


def _texts(condition: Condition, model: Model) -> dict[str, str]:
    """Stream name -> the text that fills it.

    Attributes become a text for a model that reads text alone; there they take the place of a prompt that the model
    does not read itself. A model that reads neither leaves them to the choice among candidates.
    """
    texts = condition.prompts
    if not model.text_encoder:
        return {} if reads_requests(model) else texts
    if model.denoiser.config.attributes:
        return texts
    requests = {"text": condition.attributes, "negative_text": condition.negative_attributes}
    for name, request in requests.items():
        is_open = name not in texts or (model.reads_prompts and texts[name] not in model.prompts)
        if name not in condition.streams and is_open and (text := request_text(request)):
            texts = texts | {name: text}
    return texts


def _encode_texts(texts: Sequence[str], model: Model, encoder: TextEncoder | None) -> dict[str, np.ndarray]:
    """Text -> token features [tokens, width]: those stored in the model, else from the text encoder."""
    if not model.text_encoder:
        raise ValueError(
            "Condition.prompt is given, but this model was not trained on text: leave it out, or load another one"
        )
    missing = [text for text in texts if text not in model.prompts]
    if not missing:
        return dict(model.prompts)
    encoder = encoder or load_text_encoder()
    if encoder.name != model.text_encoder:
        raise ValueError(
            f"Condition.prompt needs the encoder that this model was trained with, {model.text_encoder}, but the text "
            f"encoder here is {encoder.name}: "
            "give the folder of that one by the variable SCJAX_TEXT_ENCODER"
        )
    for text in missing:
        if encoder.is_cut(text):
            warnings.warn(f"a prompt of {len(text.split())} words is too long: its end is not read", stacklevel=4)
    encoded = {text: tokens.features for text, tokens in zip(missing, encoder(missing), strict=True)}
    return {**model.prompts, **encoded}


def check_readable(streams: Sequence[Streams], condition: ConditionConfig) -> None:
    """Checks that a network reads all these streams.

    Args:
      streams: the streams of every scene.
      condition: what the network reads (``DenoiserConfig.condition``).

    Raises:
      ValueError: names the stream, what the network reads, and the cure.
    """
    reader = _READERS[type(condition)]
    reads = f"reads {' and '.join(reader.names)}" if reader.names else "is unconditional"
    for name in dict.fromkeys(name for row in streams for name in row):
        if name not in reader.names:
            raise ValueError(
                f"Condition.streams[{name!r}] is given, but this model {reads}: leave {name!r} out, or load a model "
                "that reads it"
            )
    reader.check(streams, condition)


def network_inputs(streams: Sequence[Streams], condition: ConditionConfig) -> NetworkInputs:
    """The features of a batch of scenes, as the denoiser takes them.

    Args:
      streams: the streams of every scene, all readable (``check_readable``).
      condition: what the network reads (``DenoiserConfig.condition``).
    """
    return _READERS[type(condition)].inputs(streams, condition)


def padded_length(longest: int) -> int:
    """Slots of a batch of texts whose longest has so many tokens: 64, 128, ..., so that few programs are compiled."""
    return max(64, -(-longest // 64) * 64)


def text_features(texts: Sequence[Stream | None], longest: int, width: int) -> TextFeatures:
    """Text streams as a batch, padded to ``padded_length(longest)`` slots; None is no token at all."""
    slots = padded_length(longest)
    tokens, mask = np.zeros((len(texts), slots, width), np.float32), np.zeros((len(texts), slots), bool)
    for row, text in enumerate(texts):
        if text is not None:
            tokens[row, : len(text.tokens)] = text.tokens
            mask[row, : len(text.tokens)] = True if text.mask is None else text.mask
    return TextFeatures(tokens=jnp.asarray(tokens), mask=jnp.asarray(mask))


def _check_texts(streams: Sequence[Streams], condition: TextCondition) -> None:
    for name, stream in (item for row in streams for item in row.items()):
        if np.shape(stream.tokens)[1] != condition.width:
            raise ValueError(
                f"Condition.streams[{name!r}] has tokens of width {np.shape(stream.tokens)[1]}, the model takes "
                f"{condition.width}: use the encoder that it was trained with"
            )


def _text_inputs(streams: Sequence[Streams], condition: TextCondition) -> NetworkInputs:
    texts, negative = ([row.get(name) for row in streams] for name in ("text", "negative_text"))
    longest = max((len(text.tokens) for text in (*texts, *negative) if text is not None), default=0)
    features = text_features(texts, longest, condition.width)
    if all(text is None for text in negative):
        return features, None
    return features, text_features(negative, longest, condition.width)


def _check_images(streams: Sequence[Streams], condition: ImageCondition) -> None:
    expected = (condition.channels, *condition.grid)
    for shape in (row["image"].grid().shape for row in streams if "image" in row):
        if shape != expected:
            raise ValueError(
                f"Condition.streams['image'] is [channels, rows, columns] {shape}, the model takes {expected}: use the "
                "encoder and the size that it was trained with"
            )
    if not condition.depth and any("depth" in row for row in streams):
        raise ValueError(
            "Condition.streams['depth'] is given, but this model reads no depth: leave it out, the features say it"
        )
    for row in streams:
        if "depth" in row and row["depth"].mask is not None and row["depth"].grid().shape[1:] != condition.grid:
            raise ValueError(
                f"Condition.streams['depth'] has a mask of {row['depth'].grid().shape[1:]} cells, the model's grid has "
                f"{condition.grid}: bring masked depth to that grid"
            )
    sizes = sorted({row["depth"].grid().shape[1:] for row in streams if "depth" in row})
    if len(sizes) > 1:
        raise ValueError(f"Condition.streams['depth'] of one call have the sizes {sizes}: bring them to one")


def _image_inputs(streams: Sequence[Streams], condition: ImageCondition) -> NetworkInputs:
    if not any("image" in row for row in streams):
        return None, None  # the same scenes by a smaller program
    grids = [_masked(row["image"]).grid() if "image" in row else None for row in streams]
    depths = [_masked(row["depth"]).grid()[0] if "depth" in row else None for row in streams]
    size = next((depth.shape for depth in depths if depth is not None), condition.grid)
    no_image, no_depth = np.zeros((condition.channels, *condition.grid), np.float32), np.zeros(size, np.float32)
    features = ImageFeatures(
        dino=jnp.asarray(np.stack([no_image if grid is None else grid for grid in grids]), jnp.float32),
        depth=jnp.asarray(np.stack([no_depth if depth is None else depth for depth in depths]), jnp.float32),
        present=jnp.asarray([grid is not None for grid in grids]),
        mask=_cell_masks(streams, condition),
    )
    return features, None


def _masked(stream: Stream) -> Stream:
    """The stream with zeros in place of tokens that are not real, which may hold anything."""
    if stream.mask is None:
        return stream
    tokens = np.where(np.asarray(stream.mask)[:, None], np.asarray(stream.tokens), 0)
    return dataclasses.replace(stream, tokens=tokens)


def _cell_masks(streams: Sequence[Streams], condition: ImageCondition) -> Array | None:
    """Cells of image and depth that are read; None where all are, so that nothing else is compiled."""
    number = condition.grid[0] * condition.grid[1]

    def mask(row: Streams, name: str) -> np.ndarray:
        stream = row.get(name)
        if stream is None:
            return np.full(number, not (condition.depth and "image" in row))  # no depth of a picture
        return np.ones(number, bool) if stream.mask is None else np.asarray(stream.mask)

    masks = np.stack([np.concatenate([mask(row, "image"), mask(row, "depth")]) for row in streams])
    return None if masks.all() else jnp.asarray(masks)


@dataclasses.dataclass(frozen=True)
class _Reader:
    """How one type of network reads streams: their names, a check of their shapes, and the translation."""

    names: tuple[str, ...]
    check: Callable[[Sequence[Streams], Any], None]
    inputs: Callable[[Sequence[Streams], Any], NetworkInputs]


_READERS: dict[type, _Reader] = {
    type(None): _Reader((), lambda streams, condition: None, lambda streams, condition: (None, None)),
    TextCondition: _Reader(("text", "negative_text"), _check_texts, _text_inputs),
    ImageCondition: _Reader(("image", "depth"), _check_images, _image_inputs),
}
