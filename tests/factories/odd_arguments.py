"""Calls with odd arguments, run as a program: the type checks of the test session would refuse them first.

``python -m tests.factories.odd_arguments`` prints one JSON list: name of the case, kind of the error, its message.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

import scjax
from scjax import Condition, Guidance, Stream
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.nn import stored_program
from scjax.scene import Crop, Scene, unpadded
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model

COUNTS: dict[str, Any] = {"num_lanes": 3, "num_agents": 2}
NAN, INF = float("nan"), float("inf")
CONDITIONS: dict[str, list[Any]] = {
    "num_lanes": [INF, NAN, [3], "3", True, 1.5, 0, 10**30, np.array([3])],
    "num_agents": [[3], object(), -1],
    "domain": [0.5, [0], True, -1, b"city"],
    "crop": [7, "round", 0.5],
    "prompt": [3, b"a road", ["a road"], "", "  ", "\ud800", "a" * 200_000],
    "negative_prompt": [3],
    "known": [3, "scene", {}],
    "streams": [3, [1], {"text": np.zeros((2, 3))}, {"sound": None}],
}
OPTIONS: dict[str, list[Any]] = {
    "num_scenes": [1.5, "2", 0, True, NAN],
    "num_steps": [2.5, "2", 1, 101],
    "best_of": ["2", 0],
    "temperature": ["1", NAN, INF, 0.0, -1.0, 1e30, [1.0]],
    "guidance": [[4], "4", NAN, -1e30, True],
    "sampler": [3, "magic", object()],
    "energy_guidance": ["yes", 1],
    "repair": ["yes", 1],
    "padded_size": [3, "ab", (1,), (1, NAN)],
    "model": [3, {}, "no such folder"],
    "condition": [3, b"road", [3], {"prompt": "a road"}],
}
KEYS: list[Any] = ["0", None, 0.5, -1, True, 2**64, np.zeros(2, np.uint32), jax.random.split(jax.random.key(0))]
STREAMS: list[tuple[str, dict[str, Any]]] = [
    ("tokens", {"tokens": np.zeros((0, 4))}),
    ("tokens", {"tokens": np.full((2, 4), NAN)}),
    ("tokens", {"tokens": [[1.0, 2.0]]}),
    ("tokens", {"tokens": np.array([["a"]])}),
    ("mask", {"tokens": np.ones((2, 4)), "mask": np.ones(3, bool)}),
    ("mask", {"tokens": np.ones((2, 4)), "mask": np.ones(2)}),
    ("positions", {"tokens": np.ones((2, 4)), "positions": np.full((2, 2), INF)}),
]
DEPTHS: list[Any] = [np.zeros((0, 0)), np.full((2, 2), NAN), "depth", np.zeros(3)]
KNOWN: list[dict[str, tuple[Any, Any]]] = [
    {"agents": ((1, 0), NAN)},
    {"lanes": ((0, 3, 1), INF)},
    {"agents": ((1, 6), -4.0)},
    {"agents": ((1, slice(4, 6)), 0.0)},
    {"signals": (0, 17)},
    {"links": ((0, 1), 3)},
    {"agents": ((1, 0), 1e30)},
    {"domain": ((), -1)},
]
DATACLASSES: list[tuple[type, str, Any]] = [
    *((Guidance, "scale", value) for value in ("4", NAN, 1e30, [1])),
    *((Guidance, "rescale", value) for value in ("1", 2.0, NAN)),
    *((Guidance, "interval", value) for value in (3, (1,), ("a", "b"), (2, 1), (NAN, 1))),
    *((EnergyGuidance, "gradient_steps", value) for value in (0, 1.5, "2", 10**9)),
    *((EnergyGuidance, "max_sigma", value) for value in (NAN, "1", 2)),
    *((EnergyGuidance, "momentum", value) for value in (NAN, 1, "0")),
    *((EnergyGuidance, "energies", value) for value in ((), (("magic", 1.0),), (("overlap", NAN),), ("overlap",))),
]


def known_scene(changes: dict[str, tuple[Any, Any]]) -> Scene:
    """A scene with some values replaced: field -> (place, value)."""
    scene = unpadded(example_scene(2, agents=3, lanes=4))
    fields = {name: np.array(value) for name, value in scene.to_dict().items()}
    for name, (place, value) in changes.items():
        fields[name][place] = value
    return scene.replace(**fields)


def sample(**options: Any) -> Scene:
    """Samples from a tiny model."""
    arguments = {"key": 0, "condition": Condition(**COUNTS), "model": tiny_model(), "num_steps": 2, **options}
    return scjax.sample(arguments.pop("key"), arguments.pop("condition"), **arguments)


def _read_whole_numbers() -> None:
    condition = Condition(num_lanes=3.0, num_agents=np.int16(2), domain=np.int32(1), crop="forward")  # pyright: ignore
    assert (condition.num_lanes, condition.num_agents, condition.domain) == (3, 2, 1)
    assert condition.crop is Crop.FORWARD and type(condition.num_lanes) is int
    sample(num_steps=2.0, num_scenes=np.int64(1), key=np.int64(3))


def calls() -> Iterator[tuple[str, Callable[[], Any]]]:
    """(what the message must name, the call) of every case; the first one is accepted."""
    yield "read", _read_whole_numbers
    for name, values in CONDITIONS.items():
        yield from ((f"Condition.{name}", lambda n=name, v=value: Condition(**{n: v})) for value in values)
    for name, values in OPTIONS.items():
        yield from ((name, lambda n=name, v=value: sample(**{n: v})) for value in values)
    yield from (("key", lambda v=key: sample(key=v)) for key in KEYS)
    yield from ((f"Stream.{name}", lambda f=fields: Stream(**f)) for name, fields in STREAMS)
    yield from (("depth map", lambda v=depth: Stream.from_depth(v)) for depth in DEPTHS)
    yield from (("Condition.known", lambda c=changes: Condition(known=known_scene(c))) for changes in KNOWN)
    yield from ((f"{kind.__name__}.{name}", lambda k=kind, n=name, v=v: k(**{n: v})) for kind, name, v in DATACLASSES)


def main() -> None:
    """Runs every case and prints what came of it."""
    stored_program._MAX_FILES = 10_000  # in the folder of the test session, whose programs are to stay
    results = []
    for name, call in calls():
        try:
            call()
            results.append((name, "accepted", ""))
        except Exception as error:
            results.append((name, type(error).__name__, str(error)))
    json.dump(results, sys.stdout)


if __name__ == "__main__":
    main()
