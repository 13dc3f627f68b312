"""Scenes made by hand, whose metrics are known, and the shared evaluation tiles as scenes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from scjax.evaluate.eval_tiles import tile_scene
from scjax.scene import AgentType, Link, Scene, empty, validate

CAR = (4.0, 2.0, 1.5)
_SHARED = Path(os.environ.get("SCJAX_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "eval"


def lane(start: tuple[float, float], end: tuple[float, float], z: float = 0.0) -> np.ndarray:
    """A straight lane of 20 points."""
    share = np.linspace(0, 1, 20)[:, None]
    xy = np.array(start) * (1 - share) + np.array(end) * share
    return np.concatenate([xy, np.full((20, 1), z)], 1).astype(np.float32)


def agent(x: float, y: float, heading: float = 0.0, speed: float = 0.0, size=CAR) -> np.ndarray:
    """Nine columns; heading in degrees."""
    turn = np.deg2rad(heading)
    return np.array([x, y, size[2] / 2, speed, np.cos(turn), np.sin(turn), *size], np.float32)


def scene(agents=(), lanes=(), *, types=None, joined=(), left=()) -> Scene:
    """A valid scene of ``agents`` (vehicles unless ``types`` says otherwise) and ``lanes``.

    ``joined`` holds pairs (i, j), traffic flows from i into j; ``left`` pairs (i, j), i is the left neighbour of j.
    """
    blank = empty(len(agents), len(lanes))
    links = blank.links
    np.fill_diagonal(links, Link.SELF)
    for i, j in joined:
        links[i, j], links[j, i] = Link.PREDECESSOR, Link.SUCCESSOR
    for i, j in left:
        links[i, j], links[j, i] = Link.LEFT, Link.RIGHT
    return validate(
        blank.replace(
            agents=np.stack(agents) if len(agents) else blank.agents,
            agent_types=np.array([AgentType.VEHICLE] * len(agents) if types is None else types, np.int32),
            agent_mask=np.ones(len(agents), bool),
            agent_known=np.ones((len(agents), 9), bool),
            lanes=np.stack(lanes) if len(lanes) else blank.lanes,
            lane_mask=np.ones(len(lanes), bool),
            lane_known=np.ones((len(lanes), 3), bool),
            links=links,
        )
    )


def random_traffic(seed: int, cars: int = 8, lanes: int = 9) -> Scene:
    """A scene with random lanes, connections and cars."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-30, 30, (lanes, 2, 2))
    joined = {(int(i), int(j)) for i, j in rng.integers(lanes, size=(lanes, 2)) if i < j}
    sizes = rng.uniform((3.5, 1.6, 1.4), (7, 2.6, 3), (cars, 3))
    boxes = [agent(*rng.uniform(-25, 25, 2), rng.uniform(-180, 180), rng.uniform(0, 15), size) for size in sizes]
    return scene(boxes, [lane(tuple(a), tuple(b)) for a, b in ends], joined=sorted(joined))


def crossing() -> Scene:
    """The ego on a road of two joined lanes and their left neighbour, a car beside it, a pedestrian, a cyclist."""
    pedestrian, cyclist = agent(8, -6, 90, 1, (0.6, 0.6, 1.7)), agent(-9, 0, 0, 4, (1.8, 0.7, 1.7))
    return scene(
        agents=[agent(0, 0), agent(12, 3.5, 0, 5), pedestrian, cyclist],
        types=[AgentType.VEHICLE, AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.CYCLIST],
        lanes=[lane((-32, 0), (4, 0)), lane((4, 0), (32, 0)), lane((-32, 3.5), (32, 3.5))],
        joined=[(0, 1)],
        left=[(2, 0), (2, 1)],
    )


def eval_table(folder: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of tiles_real_<name>.npz or tiles_<name>.npz, in ``folder`` or else in the shared folder."""
    for place in (folder, _SHARED):
        for path in (place / f"tiles_real_{name}.npz", place / f"tiles_{name}.npz"):
            if path.is_file():
                with np.load(path) as data:
                    return dict(data)
    pytest.skip(f"tiles of the set {name} are neither in {folder} nor in the shared folder")


def eval_tiles(folder: Path, name: str, *, variant: str = "main", only: list[int] | None = None) -> list[Scene]:
    """Tiles of tiles_<name>.npz as scenes, their agents in the given variant (main or all)."""
    table = eval_table(folder, name)
    every = range(len(table["lane_offsets"]) - 1)
    return [tile_scene(table, tile, variant) for tile in (every if only is None else only)]
