"""How long it takes to cut a scene from a map."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping

import numpy as np

from scjax.data.map_crop import crop_map
from scjax.scene import Log, Map, MapLane, log_to_map
from scjax.scene.map_lane import NO_CAR_LANE_TYPES

PLACES, EDGE, SPACING = 9, 5000.0, 100.0  # scenes of a map; m of a grid of streets


def crop_times(logs: Mapping[str, Log]) -> list[dict]:
    """CPU seconds for each scene of the three largest maps and of a grid of streets of 5 km."""
    maps = {name: log_to_map(log) for name, log in logs.items()}
    largest = sorted(maps, key=lambda name: -maps[name].num_lanes)[:3]
    grid = street_grid()
    rows = [_times(name, maps[name]) for name in largest]
    return [*rows, _times(f"streets of {EDGE / 1000:g} km, {SPACING:g} m apart", grid)]


def street_grid() -> Map:
    """Streets of two lanes along x and y, cut at every crossing."""
    places, lanes = np.arange(0.0, EDGE + 1e-6, SPACING), []
    for across, place in enumerate(places):
        for step in range(len(places) - 1):
            along = np.linspace(places[step], places[step + 1], 51)
            for axis in (0, 1):
                for order in (1, -1):
                    points = np.zeros((len(along), 3))
                    points[:, axis] = along[::order]
                    points[:, 1 - axis] = place - 2.0 * order * (1 if axis == 0 else -1)
                    after, before = (f"{axis}.{across}.{step + shift}.{order}" for shift in (order, -order))
                    lanes.append(MapLane(f"{axis}.{across}.{step}.{order}", None, points, (before,), (after,)))
    return Map(lanes=tuple(lanes))


def _times(name: str, map: Map) -> dict:
    driven = [lane for lane in map.lanes if lane.lane_type not in NO_CAR_LANE_TYPES]
    places = [lane.points[len(lane.points) // 2] for lane in driven[:: max(len(driven) // PLACES, 1)][:PLACES]]
    seconds = []
    for place in places:
        start = time.process_time()
        crop_map(map, *place[:2].tolist())
        seconds.append(time.process_time() - start)
    x_min, x_max, y_min, y_max = map.extent
    return {
        "map": name,
        "lanes": map.num_lanes,
        "points": sum(len(lane.points) for lane in map.lanes),
        "extent": [round(x_max - x_min), round(y_max - y_min)],
        "median_seconds": round(statistics.median(seconds), 3),
        "most_seconds": round(max(seconds), 3),
    }
