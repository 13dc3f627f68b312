"""``Condition``, ``Stream`` and the arguments of ``sample``, with tiny models."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import areas_streams, damage_bytes, names
from benchmarks.robustness.case import SOUND, Case
from benchmarks.robustness.damage_json import show
from benchmarks.robustness.tiny_sampling import result_fault, sample_tiny

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
    yield from areas_streams.tokens(rng, fixtures)


def _show(value: Any) -> str:
    text = show(value) if not isinstance(value, np.ndarray | np.generic) else repr(value)
    return text if " at 0x" not in text else type(value).__name__


def _case(
    text: str, fixtures: Path, kind: str, fields: dict[str, Any], arguments: dict[str, Any], words: tuple[str, ...]
) -> Case:
    def read(folder: Path) -> Any:
        return sample_tiny(fixtures, kind, fields, arguments)

    return Case(text, read, lambda scenes: result_fault(scenes, fields, arguments), words)


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
