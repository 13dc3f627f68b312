"""Conditions as inputs of the networks: conditions become streams of tokens, and streams become batched features.

This is the only place that knows what makes streams, and which streams a network reads.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.generate.conditions import Condition, Stream
from scjax.generate.image_streams import image_streams
from scjax.generate.model import Model
from scjax.generate.text_streams import text_streams
from scjax.models.denoiser.config import ConditionConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ConditionFeatures, ImageFeatures, TextFeatures

Streams = Mapping[str, Stream]
NetworkInputs = tuple[ConditionFeatures | None, TextFeatures | None]
"""Features of the conditions, and of the negative prompts that guidance leads away from; None where there are none."""


StreamEncoder = Callable[[Sequence[Condition], Model], Sequence[Streams]]
"""Makes the streams of one kind of input, one mapping for each condition; each different input is encoded once."""

STREAM_ENCODERS: tuple[StreamEncoder, ...] = (text_streams, image_streams)
"""All that makes streams of conditions. A new encoder is one file with such a function, and its name here."""


def encode_conditions(conditions: Sequence[Condition], model: Model) -> list[Streams]:
    """The streams of every condition: those that are given, and those of its prompts, pictures and attributes.

    Raises:
      ValueError: the model cannot read a stream, or an encoder is not here or not the model's.
    """
    network = model.denoiser.config.condition
    streams: list[Streams] = [condition.streams for condition in conditions]
    for make_streams in STREAM_ENCODERS:
        more = _without_cameras(make_streams(conditions, model), network)
        streams = [{**own, **others} for own, others in zip(streams, more, strict=True)]
    check_readable(streams, network)
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
