"""``Condition``, ``Stream`` and the arguments of ``sample``, with tiny models."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import damage_bytes, names
from benchmarks.robustness.case import SOUND, Case
from benchmarks.robustness.damage_json import show
from benchmarks.robustness.fixtures import PROMPT, WIDTH
from benchmarks.robustness.invariants import scene_fault

_COUNTS = {"num_lanes": 3, "num_agents": 2}
_ODD: tuple[Any, ...] = (
    True,
    False,
    -1,
    0,
    1,
    2**40,
    2**70,
    1.5,
    3.0,
    -0.5,
    1e30,
    float("nan"),
    float("inf"),
    np.int64(3),
    np.float32(3),
    "2",
    "word",
    "",
    b"2",
    [],
    [3],
    (2,),
    (2, 3),
    {},
    {"a": 1},
    object(),
    np.array(3),
    np.array([1, 2]),
    np.array("x"),
    1j,
    len,
)
_FIELDS = ("num_lanes", "num_agents", "domain", "crop", "known", "prompt", "negative_prompt")
_ARGUMENTS = (
    "condition",
    "model",
    "num_scenes",
    "num_steps",
    "guidance",
    "sampler",
    "best_of",
    "repair",
    "temperature",
    "energy_guidance",
    "padded_size",
)
_ONLY_OLD = ("tokens", "token_mask", "negative_tokens", "image", "depth", "events", "light")


def requests(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Every argument with values of other types, out of range, or that do not fit; known scenes that are damaged."""
    old = names.is_old()
    absent = ("best_of", "repair", "padded_size", "condition") if old else ()
    for name in (*_FIELDS, *(_ONLY_OLD if old else ("streams",))):
        for value in _ODD:
            kind = "image" if name in ("image", "depth") else "text" if "prompt" in name or "token" in name else "plain"
            yield _case(
                f"Condition.{name} = {_show(value)}",
                fixtures,
                kind,
                {name: value},
                {},
                (name, name.removeprefix("negative_"), names.OLD_FIELDS.get(name, name), "text encoder"),
            )
    for name in _ARGUMENTS:
        if name in absent:
            continue
        for value in _ODD:
            yield _case(
                f"{name} = {_show(value)}",
                fixtures,
                "plain",
                {},
                {name: value},
                (name, names.OLD_ARGUMENTS.get(name, name)),
            )
    for kind in ("plain", "text"):
        yield _case(f"{kind}: {SOUND}", fixtures, kind, {}, {}, ())
    for value in (None, 0, "0", 1.5, [1, 2], np.zeros(2, np.uint32), object()):
        yield _case(f"key = {_show(value)}", fixtures, "plain", {}, {"key": value}, ("key",))
    yield from _known(rng, fixtures)
    yield from _tokens(rng, fixtures, old)


def _show(value: Any) -> str:
    text = show(value) if not isinstance(value, np.ndarray | np.generic) else repr(value)
    return text if " at 0x" not in text else type(value).__name__


def _case(
    text: str, fixtures: Path, kind: str, fields: dict[str, Any], arguments: dict[str, Any], words: tuple[str, ...]
) -> Case:
    def read(folder: Path) -> Any:
        return _sample(fixtures, kind, fields, arguments)

    return Case(text, read, lambda scenes: _fault(scenes, fields, arguments), words)


_models: dict[str, Any] = {}


def _sample(fixtures: Path, kind: str, fields: dict[str, Any], arguments: dict[str, Any]) -> Any:
    import jax

    if kind not in _models:
        _models[kind] = names.get("load_model")(fixtures / kind)
    given = {**_COUNTS, **fields}
    if kind == "text" and not {"prompt", "streams", "tokens", "negative_tokens"} & set(fields):
        given["prompt"] = PROMPT
    keywords = {"model": _models[kind], "num_steps": 2, **arguments}
    key = keywords.pop("key", jax.random.key(0))
    condition = keywords.pop("condition") if "condition" in keywords else _condition(given)
    return names.get("sample")(key, condition, **names.sample_arguments(keywords))


def _condition(fields: dict[str, Any]) -> Any:
    return names.get("Condition")(**names.condition_fields(fields))


def _fault(scenes: Any, fields: dict[str, Any], arguments: dict[str, Any]) -> str | None:
    if isinstance(scenes, list):
        return next((fault for scene in scenes if (fault := scene_fault(scene.to_numpy()))), None)
    scenes = scenes.to_numpy()
    if fault := scene_fault(scenes):
        return fault
    if "condition" in arguments:
        return None
    if len(scenes.agent_mask) != int(arguments.get("num_scenes", 1)):
        return f"{len(scenes.agent_mask)} scenes for {arguments['num_scenes']!r}"
    for name in _COUNTS:
        wanted, counts = fields.get(name, _COUNTS[name]), getattr(scenes, name)
        if wanted is not None and not (counts == int(wanted)).all():
            return f"{name} is {counts[0]}, not {wanted!r}"
    for name, largest in (("temperature", 1e6), ("guidance", 1e6)):
        value = arguments.get(name)
        if isinstance(value, int | float) and abs(value) > largest:
            return f"{name} of {value} is accepted"
    known = fields.get("known")
    if known is not None and hasattr(known, "agents"):
        rows = np.asarray(known.agents)[np.asarray(known.agent_mask)]
        if not np.array_equal(scenes.agents[0, : len(rows)], rows.astype(np.float32)):
            return "known agents are not kept"
    return None


def _known(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Known scenes: every field damaged, of other sizes, as a batch, padded, on the device."""
    example, stack, permute = names.get("example_scene"), names.get("stack"), names.get("permute")
    scene = example(0, agents=2, lanes=3, padding=0)
    counts = {"num_lanes": 5, "num_agents": 4}
    whole = {
        "a batch": stack([scene, scene]),
        "a batch of one": stack([scene]),
        "padded": example(0, agents=2, lanes=3, padding=2),
        "its arrays": scene.to_dict(),
        "without lanes": permute(scene, np.arange(2), np.arange(0)),
        "empty": permute(scene, np.arange(0), np.arange(0)),
        "more than the counts": example(0, agents=9, lanes=9, padding=0),
        "more than the model": example(0, agents=70, lanes=120, padding=0),
    }
    for text, known in whole.items():
        yield _case(
            f"known: {text}",
            fixtures,
            "plain",
            {**counts, "known": known},
            {},
            ("known", "Condition.num_lanes", "Condition.num_agents"),
        )
    fields = list(scene.to_dict())
    for k in range(66):
        name = fields[k % len(fields)]
        text, array = damage_bytes.array_damage(rng, np.asarray(getattr(scene, name)))
        known = scene.replace(**{name: array})
        yield _case(f"known.{name}: {text}", fixtures, "plain", {**counts, "known": known}, {}, ("known",))


def _tokens(rng: np.random.Generator, fixtures: Path, old: bool) -> Iterator[Case]:
    """Streams of tokens: values that are not finite, other widths, types, masks and positions; images and depths."""
    good = rng.normal(size=(4, WIDTH)).astype(np.float32)
    tokens = {
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
    for text, value in tokens.items():
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
        return _sample(fixtures, kind, fields, {})

    return Case(
        text,
        read,
        lambda scenes: _fault(scenes, {}, {}),
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
        return _sample(fixtures, "image", fields, {})

    return Case(text, read, lambda scenes: _fault(scenes, {}, {}), ("Condition.streams", "image", "images", "depth"))
