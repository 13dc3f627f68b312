"""Logs and consumers for tests of exports."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from consumers.environments import python_of
from scjax.scene import AgentType, LaneNeighbor, Log, MapLane, Signal
from tests.factories.logs import example_log

RADIUS = 12.0  # m


def crossing_log(**changes) -> Log:
    """A road from the west that forks; a road from the south merges into it, another one crosses it.

    Lanes: "in" -> "straight" -> "out"; "in" -> "left" -> "north"; "south" -> "merge" -> "out"; "across" crosses
    "straight". The signal is that of "straight". The ego drives from "in" to "out"; a cyclist is seen late.
    """
    angle = np.linspace(0, np.pi / 2, 13)
    lanes = {
        "in": _line((-80, 0), (0, 0)),
        "straight": _line((0, 0), (30, 0)),
        "out": _line((30, 0), (100, 0)),
        "left": np.stack([RADIUS * np.sin(angle), RADIUS * (1 - np.cos(angle))], -1),
        "north": _line((RADIUS, RADIUS), (RADIUS, 70)),
        "south": _line((18, -70), (18, -12)),
        "merge": np.stack([30 - 12 * np.cos(angle), -12 + 12 * np.sin(angle)], -1),
        "across": _line((24, 60), (24, -60)),
    }
    links = [("in", "straight"), ("in", "left"), ("straight", "out"), ("left", "north"), ("south", "merge")]
    links += [("merge", "out")]
    steps = np.arange(20)
    positions = np.zeros((2, 20, 3))
    positions[0] = np.stack([-60 + steps, np.zeros(20), np.full(20, 2.8)], -1)
    positions[1] = np.stack([np.full(20, 24.0), 40.0 - 0.5 * steps, np.full(20, 3.0)], -1)
    valid = np.ones((2, 20), bool)
    valid[1, :5] = False
    log = Log(
        timestamps=0.1 * steps,
        object_ids=("car", "rider"),
        object_types=np.array([AgentType.VEHICLE, AgentType.CYCLIST]),
        valid=valid,
        positions=positions,
        headings=np.repeat([[0.0], [-np.pi / 2]], 20, 1),
        velocities=np.stack([np.repeat([[10.0], [0.0]], 20, 1), np.repeat([[0.0], [-5.0]], 20, 1)], -1),
        sizes=np.array([[4.5, 2.0, 1.6], [1.8, 0.8, 1.7]]),
        ego_index=0,
        signal_lane_ids=("straight",),
        signal_states=np.where(steps < 8, Signal.STOP, Signal.GO)[None],
        signal_positions=np.array([[0.0, 0.0, 2.0]]),
        lanes=tuple(
            MapLane(
                name,
                "surface_street",
                np.column_stack([line, np.full(len(line), 2.0)]),
                tuple(a for a, b in links if b == name),
                tuple(b for a, b in links if a == name),
            )
            for name, line in lanes.items()
        ),
        has_topology=True,
        metadata=dataclasses.replace(example_log().metadata, scene_id="crossing", domain="village"),
    )
    return dataclasses.replace(log, **changes)


def two_lane_log() -> Log:
    """A street of two lanes side by side that go the same way, with a bend and a slope; nobody is on it."""
    x = np.arange(0.0, 101.0, 2.0)
    center = np.stack([x, 10 * np.sin(x / 40), 0.05 * x], -1)
    slope = np.arctan(0.25 * np.cos(x / 40))
    aside = 3.5 * np.stack([-np.sin(slope), np.cos(slope), np.zeros(len(x))], -1)
    last = len(x) - 1
    lanes = (
        MapLane("left", "freeway", center + aside, right_neighbors=(LaneNeighbor("right", 0, last, 0, last),)),
        MapLane("right", "freeway", center, left_neighbors=(LaneNeighbor("left", 0, last, 0, last),)),
    )
    log = crossing_log()
    return dataclasses.replace(log, lanes=lanes, signal_lane_ids=(), signal_states=np.zeros((0, 20), int),
                               signal_positions=np.zeros((0, 3)))  # fmt: skip


def mixed_node_log(is_full: bool = True) -> Log:
    """Two lanes from the west that lead to two lanes to the east, all in one point; nobody is on them.

    Args:
      is_full: whether each leads to each; else "below" leads to "right" alone.
    """
    lines = {
        "above": _line((-60, 20), (0, 0)),
        "below": _line((-60, -20), (0, 0)),
        "left": _line((0, 0), (60, 20)),
        "right": _line((0, 0), (60, -20)),
    }
    links = [("above", "left"), ("above", "right"), ("below", "right"), ("below", "left")][: 4 if is_full else 3]
    lanes = tuple(
        MapLane(
            name,
            "surface_street",
            np.column_stack([line, np.full(len(line), 2.0)]),
            tuple(a for a, b in links if b == name),
            tuple(b for a, b in links if a == name),
        )
        for name, line in lines.items()
    )
    return dataclasses.replace(two_lane_log(), lanes=lanes)


def consumer_python(name: str) -> str:
    """The interpreter of a consumer's environment; skips the test where it is not there."""
    python = python_of(name)
    if python is None:
        pytest.skip(f"consumer {name} is not installed: python -m consumers.make {name}")
    return str(python)


def _line(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    """Points about 2 m apart."""
    count = max(int(np.hypot(end[0] - start[0], end[1] - start[1]) / 2), 2) + 1
    return np.linspace(start, end, count).astype(float)
