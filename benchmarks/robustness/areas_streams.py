"""Streams of condition tokens, images and depths."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import names
from benchmarks.robustness.case import Case
from benchmarks.robustness.fixtures import PROMPT, WIDTH
from benchmarks.robustness.tiny_sampling import result_fault, sample_tiny


def tokens(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Streams of tokens: values that are not finite, other widths, types, masks and positions; images and depths."""
    old = names.is_old()
    good = rng.normal(size=(4, WIDTH)).astype(np.float32)
    features_by_text = {
        "good": good,
        "NaN": np.where(np.eye(4, WIDTH) > 0, np.nan, good),
        "infinity": good + np.inf,
        "1e30": good * np.float32(1e30),
        "another width": good[:, :3],
        "no tokens": good[:0],
        "no width": good[:, :0],
        "600 tokens": np.tile(good, (150, 1)),
        "whole numbers": np.ones((4, WIDTH), np.int64),
        "booleans": np.ones((4, WIDTH), bool),
        "complex": good.astype(complex),
        "texts": good.astype(str),
        "objects": good.astype(object),
        "a list": good.tolist(),
        "one row": good[0],
        "a batch": good[None],
        "a number": 3.0,
        "a text": PROMPT,
    }
    masks = {
        "good": np.ones(4, bool),
        "too short": np.ones(3, bool),
        "none real": np.zeros(4, bool),
        "numbers": np.ones(4),
        "NaN": np.full(4, np.nan),
        "two axes": np.ones((4, 1), bool),
        "a list": [True] * 4,
        "texts": np.array(list("abcd")),
        "a number": 1,
    }
    for text, value in features_by_text.items():
        yield _stream(f"tokens: {text}", fixtures, "text", {"text": (value, None)}, old)
        yield _stream(
            f"negative tokens: {text}", fixtures, "text", {"text": (good, None), "negative_text": (value, None)}, old
        )
        yield _stream(f"tokens for a model without text: {text}", fixtures, "plain", {"text": (value, None)}, old)
    for text, mask in masks.items():
        yield _stream(f"mask: {text}", fixtures, "text", {"text": (good, mask)}, old)
    image, depth = rng.normal(size=(3, 2, 2)).astype(np.float32), rng.random((2, 2)).astype(np.float32)
    images = {
        "good": (image, depth),
        "NaN": (image * np.nan, depth),
        "NaN depth": (image, depth * np.nan),
        "depth of 0 x 0": (image, depth[:0, :0]),
        "depth of another size": (image, np.ones((5, 7))),
        "another grid": (np.ones((3, 4, 4)), depth),
        "other channels": (image[:2], depth),
        "flat": (image[0], depth),
        "a list": (image.tolist(), depth.tolist()),
        "texts": (image.astype(str), depth.astype(str)),
        "infinite depth": (image, depth + np.inf),
        "depth of 1e30": (image, depth + 1e30),
        "complex": (image * 1j, depth),
    }
    for text, (features, depths) in images.items():
        yield _camera(f"image: {text}", fixtures, features, depths, old)


def _stream(text: str, fixtures: Path, kind: str, streams: dict[str, tuple[Any, Any]], old: bool) -> Case:
    def read(folder: Path) -> Any:
        if old:
            fields = {"tokens": streams["text"][0], "token_mask": streams["text"][1]}
            if "negative_text" in streams:
                fields["negative_tokens"] = streams["negative_text"][0]
        else:
            stream = names.get("Stream")
            fields = {"streams": {name: stream(value, mask) for name, (value, mask) in streams.items()}}
        return sample_tiny(fixtures, kind, fields, {})

    return Case(
        text,
        read,
        lambda scenes: result_fault(scenes, {}, {}),
        (
            "Condition.streams",
            "streams",
            "Stream.tokens",
            "Stream.mask",
            "Condition.tokens",
            "Condition.negative_tokens",
            "Condition.token_mask",
            "tokens",
            "mask",
        ),
    )


def _camera(text: str, fixtures: Path, image: Any, depth: Any, old: bool) -> Case:
    def read(folder: Path) -> Any:
        fields: dict[str, Any] = {"crop": 2}
        if old:
            fields |= {"image": image, "depth": depth}
        else:
            stream = names.get("Stream")
            fields["streams"] = {"image": stream.from_image(image), "depth": stream.from_depth(depth)}
        return sample_tiny(fixtures, "image", fields, {})

    return Case(
        text, read, lambda scenes: result_fault(scenes, {}, {}), ("Condition.streams", "image", "images", "depth")
    )
