"""A small recording in the scene-json-1 format, as JSON content and as files."""

from __future__ import annotations

import copy
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np

STEPS = 31


def lane(name: Any, start, end, spacing: float = 0.5, z: float | None = 10.0, **extra) -> dict[str, Any]:
    """A straight lane from ``start`` to ``end``."""
    count = max(int(np.hypot(end[0] - start[0], end[1] - start[1]) / spacing), 1) + 1
    x, y = np.linspace(start[0], end[0], count), np.linspace(start[1], end[1], count)
    heights = None if z is None else [z] * count
    xyz = {"x": x.tolist(), "y": y.tolist(), "z": heights}
    return {"id": name, "type": "lane", "subtype": "surface_street", **xyz, **extra}


def moving_object(
    start, velocity, *, object_type: str = "vehicle", size=(4.5, 2.0, 1.6), z: float | None = 10.8
) -> dict[str, Any]:
    """An object that moves in a straight line at 10 Hz."""
    time = np.arange(STEPS) * 0.1
    heading = float(np.arctan2(velocity[1], velocity[0]))
    return {
        "id": f"{object_type} {start}",
        "type": object_type,
        "length": size[0],
        "width": size[1],
        "height": size[2],
        "valid": [1] * STEPS,
        "x": (start[0] + velocity[0] * time).tolist(),
        "y": (start[1] + velocity[1] * time).tolist(),
        "z": None if z is None else [z] * STEPS,
        "heading": [heading] * STEPS,
        "vx": [float(velocity[0])] * STEPS,
        "vy": [float(velocity[1])] * STEPS,
        "track_to_predict": 0,
    }


def scene_content(
    scene_id: str = "hand-made", cluster: str = "village", dataset: str = "womd", **changes
) -> dict[str, Any]:
    """Lanes: 1 -> 2 and 1 -> 3 fork at the origin; 4 runs to the left of 1 and 2; 5 -> 6 come the other way.

    The recording car (object 0) drives east along 1 and 2 at 10 m/s; a van follows on lane 4; object 2 is parked off
    the road; 3 walks; 4 is a cone; 5 has no class.
    """
    scene = {
        "schema": "scene-json-1",
        "dataset": dataset,
        "scene_id": scene_id,
        "variant": "hand",
        "dt": 0.1,
        "location_cluster": cluster,
        "timestamps": (np.arange(STEPS) * 0.1).tolist(),
        "current_index": 0,
        "has": {"z": True, "topology": "infer"},
        "sdc_index": 0,
        "map": [
            lane(1, (-150, 0), (0, 0)),
            lane(2, (0.0, 0.02), (150, 0)),
            lane(3, (0, 0), (60, 80)),
            lane(4, (-150, 3.5), (150, 3.5)),
            lane(5, (150, 8), (10, 8)),
            lane(6, (10, 8), (-150, 8)),
            lane(7, (-150, -4), (150, -4)) | {"subtype": "bike_lane"},
            {"id": 8, "type": "road_edge", "subtype": None, "x": [0, 1], "y": [9, 9], "z": [10, 10]},
        ],
        "objects": [
            moving_object((-20, 0), (10, 0)),
            moving_object((-30, 3.5), (9, 0), size=(6.0, 2.4, 2.5)),
            moving_object((-10, 20), (0.0, 0.0)),
            moving_object((5, -6), (1, 0), object_type="pedestrian", size=(0.8, 0.8, 1.7)),
            moving_object((12, -7), (0.0, 0.0), object_type="traffic_cone", size=(0.4, 0.4, 0.8)),
            moving_object((14, -7), (0.0, 0.0), object_type="other"),
        ],
        "tl_states": {"2": {"lane_id": 2, "state": ["arrow_go"] * 20 + ["flashing_stop"] * 11, "x": 0, "y": 0, "z": 0}},
    }
    return {**copy.deepcopy(scene), **changes}


def write_scene_file(folder: Path, scene: dict[str, Any] | None = None, name: str | None = None) -> Path:
    """``scene`` as a file in ``folder``; a NaN stays NaN, as Python writes it."""
    scene = scene or scene_content()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name or scene['scene_id']}.json.gz"
    path.write_bytes(gzip.compress(json.dumps(scene).encode(), compresslevel=1, mtime=0))
    return path
