"""What the requests of a batch tell the network of their conditions: features of texts, or of images and depths."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from scjax.generate.conditions import Condition
from scjax.models.denoiser.config import ConditionConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ConditionFeatures, ImageFeatures, TextFeatures


def check_readable(conditions: Sequence[Condition], reads: ConditionConfig) -> None:
    """Raises ValueError where a condition holds what a network that ``reads`` this does not read, or of another
    shape."""
    kinds = {TextCondition: "texts", ImageCondition: "images"}
    told = "is unconditional" if reads is None else f"reads {kinds[type(reads)]}"
    for name, kind in (("tokens", TextCondition), ("negative_tokens", TextCondition), ("image", ImageCondition)):
        if not isinstance(reads, kind) and any(getattr(cond, name) is not None for cond in conditions):
            raise ValueError(f"Condition.{name} is given, but this model {told}: leave it out")
    if not isinstance(reads, ImageCondition):
        return
    for shape in (np.shape(cond.image) for cond in conditions if cond.image is not None):
        if shape != (reads.channels, *reads.grid):
            raise ValueError(
                f"Condition.image is [channels, rows, columns] {shape}, the model takes "
                f"{(reads.channels, *reads.grid)}: use the encoder and the size that it was trained with"
            )
    sizes = sorted({np.shape(cond.depth) for cond in conditions if cond.depth is not None})
    if len(sizes) > 1:
        raise ValueError(f"Condition.depth of one call have the sizes {sizes}: bring them to one")


def features_of(
    conditions: Sequence[Condition], reads: ConditionConfig
) -> tuple[ConditionFeatures | None, TextFeatures | None]:
    """Features of the conditions, and of what guidance leads away from; None where there is nothing to read."""
    if isinstance(reads, ImageCondition):
        return _image_features(conditions, reads), None
    if not isinstance(reads, TextCondition):
        return None, None
    texts = [(cond.tokens, cond.token_mask) for cond in conditions]
    negative = [(cond.negative_tokens, None) for cond in conditions]
    longest = max(0 if tokens is None else len(tokens) for tokens, _ in [*texts, *negative])
    features = text_features(texts, longest, reads)
    if all(tokens is None for tokens, _ in negative):
        return features, None
    return features, text_features(negative, longest, reads)


def padded_length(longest: int) -> int:
    """Slots of a batch of texts whose longest has so many tokens: 64, 128, ..., so that few programs are compiled."""
    return max(64, -(-longest // 64) * 64)


def text_features(texts: Sequence[tuple], longest: int, reads: TextCondition) -> TextFeatures:
    """(tokens, mask) of every scene, padded to ``padded_length``.

    Raises:
      ValueError: tokens of another width than the network reads.
    """
    lengths = [0 if tokens is None else len(tokens) for tokens, _ in texts]
    slots = padded_length(longest)
    padded, valid = np.zeros((len(lengths), slots, reads.width), np.float32), np.zeros((len(lengths), slots), bool)
    for row, ((tokens, mask), length) in enumerate(zip(texts, lengths, strict=True)):
        if tokens is None:
            continue
        if np.shape(tokens)[1] != reads.width:
            raise ValueError(f"Condition.tokens are {np.shape(tokens)[1]} wide, the model takes {reads.width}")
        padded[row, :length] = tokens
        valid[row, :length] = True if mask is None else mask
    return TextFeatures(tokens=jnp.asarray(padded), mask=jnp.asarray(valid))


def _image_features(conditions: Sequence[Condition], reads: ImageCondition) -> ImageFeatures:
    present = np.array([cond.image is not None for cond in conditions])
    size = next((np.shape(cond.depth) for cond in conditions if cond.depth is not None), reads.grid)
    none = np.zeros((reads.channels, *reads.grid), np.float32), np.zeros(size, np.float32)
    images, depths = zip(
        *((none if cond.image is None else (cond.image, cond.depth)) for cond in conditions), strict=True
    )
    return ImageFeatures(
        dino=jnp.asarray(np.stack(images), jnp.float32), depth=jnp.asarray(np.stack(depths), jnp.float32),
        present=jnp.asarray(present),
    )  # fmt: skip
