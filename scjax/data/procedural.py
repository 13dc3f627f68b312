"""Recordings of made-up traffic on made-up maps, as "scene-json-1" files: a source that needs no data set.

Cars keep a constant speed along lanes or queue at red lights; nothing ever overlaps. Good for tests, demonstrations
and smoke training, not a model of real traffic.
"""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from scjax.data.procedural_roads import Movement, RoadMap, make_map
from scjax.data.procedural_traffic import DT, STEPS, TIMES, Track, make_traffic
from scjax.data.scene_json import SCHEMA

_SHARES = {"straight": 0.22, "curve": 0.12, "four_way": 0.32, "t_junction": 0.24, "merge": 0.1}


def write_scenes(folder: str | Path, num_scenes: int, seed: int = 0, *, progress: bool = True) -> list[Path]:
    """Writes ``num_scenes`` files ``<folder>/procedural/<scene id>.json.gz``; scene k depends on ``seed`` and k alone.

    Every file has a map (and ``location_cluster``) of its own. Files appear whole: a temporary name, then a rename.

    Raises:
      ValueError: if ``num_scenes`` is less than 1 or ``seed`` negative.
    """
    if num_scenes < 1 or seed < 0:
        raise ValueError(f"num_scenes is {num_scenes} and seed {seed}: give at least one scene and a seed of 0 or more")
    out = Path(folder) / "procedural"
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for k in tqdm(range(num_scenes), "procedural scenes", disable=not progress or num_scenes < 100):
        content = make_scene(seed, k)
        path = out / f"{content['scene_id']}.json.gz"
        temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        text = json.dumps(content, separators=(",", ":")).encode()
        temporary.write_bytes(gzip.compress(text, compresslevel=2, mtime=0))
        temporary.replace(path)
        paths.append(path)
    return paths


def make_scene(seed: int, k: int) -> dict[str, Any]:
    """Scene ``k`` of ``seed`` as the object that a file holds (schema: the reader, ``scjax.data.scene_json``)."""
    rng = np.random.default_rng([seed, k])
    kind = str(rng.choice(list(_SHARES), p=list(_SHARES.values())))
    road = make_map(kind, rng)
    phase = road.phases[rng.integers(len(road.phases))] if road.phases else None
    tracks = make_traffic(road, phase, rng)
    world = _World(rng)
    lights = bool(road.phases) and rng.random() < 0.75
    name = f"{kind}-{seed}-{k:06d}"
    return {
        "schema": SCHEMA, "dataset": "procedural", "scene_id": name, "source_name": name, "variant": "procedural",
        "source": {"seed": seed, "index": k}, "licence": "none needed", "location": None, "date": None,
        "location_cluster": name, "dt": DT, "timestamps": _rounded(TIMES, 3), "current_index": 0,
        "has": {"z": True, "topology": "given", "traffic_lights": lights, "lane_types": True, "road_lines": False},
        "sdc_index": 0,
        "objects": [_object(i, track, world) for i, track in enumerate(tracks)],
        "map": _lanes(road, world),
        "tl_states": _lights(road, phase, world, rng) if lights and phase else {},
    }  # fmt: skip


class _World:
    """Where on earth the map lies: a turn, a shift of up to some kilometres, and gently sloping ground."""

    def __init__(self, rng: np.random.Generator):
        self.yaw, self.shift = rng.uniform(-np.pi, np.pi), rng.uniform(-5000, 5000, 2)
        self.grade, self.base = rng.normal(0, 0.01, 2).clip(-0.03, 0.03), rng.uniform(0, 200)
        self.wave, self.phase = rng.uniform(0, 0.4), rng.uniform(0, 2 * np.pi)

    def place(self, points: np.ndarray) -> np.ndarray:
        """Map coordinates [..., 2] in the world, with the height of the ground [..., 3]."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y = points[..., 0], points[..., 1]
        ground = self.base + points @ self.grade + self.wave * np.sin((x + 0.5 * y) / 30 + self.phase)
        return np.stack([cos * x - sin * y + self.shift[0], sin * x + cos * y + self.shift[1], ground], -1)


def _object(i: int, track: Track, world: _World) -> dict[str, Any]:
    places = world.place(track.places)
    heading = track.headings + world.yaw
    columns = {
        "x": (places[:, 0], 4), "y": (places[:, 1], 4), "z": (places[:, 2] + track.size[2] / 2, 4),
        "heading": (np.pi - np.mod(np.pi - heading, 2 * np.pi), 5),
        "vx": (track.speeds * np.cos(heading), 3), "vy": (track.speeds * np.sin(heading), 3),
    }  # fmt: skip
    length, width, height = _rounded(track.size, 3)
    return {
        "id": i, "type": track.type, "category": None, "length": length, "width": width, "height": height,
        "track_to_predict": 0, "valid": track.valid.astype(int).tolist(),
        **{name: _rounded(np.where(track.valid, values, 0.0), digits) for name, (values, digits) in columns.items()},
    }  # fmt: skip


def _lanes(road: RoadMap, world: _World) -> list[dict[str, Any]]:
    before: list[list[int]] = [[] for _ in road.lanes]
    for i, lane in enumerate(road.lanes):
        for after in lane.successors:
            before[after].append(i)
    items = []
    for i, lane in enumerate(road.lanes):
        x, y, z = (_rounded(values, 4) for values in world.place(lane.points).T)
        sides = {
            f"{side}_neighbors": [] if beside is None else [[beside[0], *beside[1:], *beside[1:]]]
            for side, beside in (("left", lane.left), ("right", lane.right))
        }
        items.append(
            {
                "id": i, "type": "lane", "subtype": lane.subtype, "x": x, "y": y, "z": z,
                "predecessors": before[i], "successors": lane.successors, **sides,
                "speed_limit_mph": lane.speed_limit, "interpolating": lane.turn is not None,
            }
        )  # fmt: skip
    return items


def _lights(road: RoadMap, phase: set[Movement], world: _World, rng: np.random.Generator) -> dict[str, Any]:
    """Go for the phase's connectors, at times caution towards the end; stop for all others."""
    change = STEPS - rng.integers(15, 35) if rng.random() < 0.3 else STEPS
    lights = {}
    for i, lane in enumerate(road.lanes):
        if lane.turn is not None:
            x, y, z = _rounded(world.place(lane.points[0]), 4)
            go = (lane.arm, lane.turn) in phase
            states = ["go"] * change + ["caution"] * (STEPS - change) if go else ["stop"] * STEPS
            lights[str(i)] = {"lane_id": i, "state": states, "x": x, "y": y, "z": z}
    return lights


def _rounded(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()
