"""``scjax.extend_map``: one more tile of a map."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array

from scjax.data.map_crop import find_window
from scjax.data.map_joins import connect_lanes
from scjax.generate.arguments import as_conditions, as_model, sampling_key
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.sample import sample_scenes
from scjax.outpainting.coverage import Coverage
from scjax.outpainting.dead_turns import DeadTurns, without_turns
from scjax.outpainting.exits import ends_in_window
from scjax.outpainting.tile_candidate import TileCandidate, tile_candidate
from scjax.outpainting.window import HALF, KnownWindow, WindowPose, cut_window, trim_tails
from scjax.scene import Crop, Map, MapSeam, MapTile, TileStatus, join_maps, unpadded
from scjax.scene.arguments import finite_number, truth_value, whole_number
from scjax.scene.limits import MAX_COORDINATE

MAX_CANDIDATES, MAX_RETRIES = 64, 10


def extend_map(
    key: Array | int,
    map: Map,
    condition: Condition | str | None = None,
    *,
    x: float,
    y: float,
    yaw: float,
    candidates: int = 8,
    retries: int = 2,
    model: Model | str | Path | None = None,
    num_steps: int | None = None,
    repair: bool = True,
    ego: bool = True,
) -> Map:
    """``map`` with one more tile of 64 m x 64 m, whose rear half lies on what is there.

    Lanes and agents of the map stay where they are, with three exceptions. Lanes that reach up to 10 m beyond the
    middle of the tile and end there lose that part, which is generated anew. Lanes of generated tiles are left out if
    nothing continues them and the road has another way there. Open ends within 5 cm of each other become one place if
    one new lane continues them. New lanes meet the old ones without a gap, and bend by less than 5 degrees there.

    Of several candidates, sampled as one batch, the one with the fewest faults is added; more are drawn while it has
    any.

    Args:
      key: typed key, or the number of one.
      condition: what the new part shall show; numbers of agents are those of the new part. Its ``known``, ``crop``,
        ``num_lanes`` and ``num_agents`` must be left out.
      x, y, yaw: center of the tile and its direction, in the frame of the map [m, rad]: a place on a lane at the border
        of the covered ground, looking out. ``scjax.outpaint`` finds such places.
      candidates: sampled at a time.
      retries: further times.
      model, num_steps, repair: as in ``scjax.sample``.
      ego: False: no vehicle stands for the ego of the network, such as where x, y is on no lane.

    Returns:
      The map. Its last tile says how it went: complete, incomplete with the fault, or missing, if no candidate
      continues any lane; then nothing else is new.

    Raises:
      ValueError: an option out of range, no lane in the window, or a condition that the model cannot meet.
    """
    key, model = sampling_key(key), as_model(model)
    candidates = whole_number(candidates, "candidates", 1, MAX_CANDIDATES)
    retries = whole_number(retries, "retries", 0, MAX_RETRIES)
    repair, map = truth_value(repair, "repair"), connect_lanes(map)
    x, y = (finite_number(v, n, -MAX_COORDINATE, MAX_COORDINATE) for v, n in ((x, "x"), (y, "y")))
    pose = WindowPose(*find_window(map, x, y, finite_number(yaw, "yaw")))
    condition = open_condition(condition)
    window, coverage = _known_window(map, pose, truth_value(ego, "ego"))
    name, attempts = str(len(map.tiles)), 0
    best: TileCandidate | None = None
    request = dataclasses.replace(condition, known=window.scene, crop=Crop(int(window.scene.crop)))
    for attempt in range(retries + 1):
        samples = sample_scenes(
            jax.random.fold_in(key, attempt),
            request,
            model=model,
            num_scenes=candidates,
            num_steps=num_steps,
            repair=repair,
        )
        attempts += candidates
        drawn = [tile_candidate(unpadded(samples[row].to_numpy()), window, coverage, name) for row in range(candidates)]
        best = max([*drawn, *([best] if best else [])], key=_rank)
        if not best.faults:
            break
    assert best is not None
    return _joined(map, window, best, attempts, condition.prompt or "")


def _rank(candidate: TileCandidate) -> tuple[bool, float]:
    return not candidate.faults, candidate.score


def open_condition(condition: Condition | str | None) -> Condition:
    """A condition for tiles, in which nothing is said that the map decides.

    Raises:
      ValueError: names the field to leave out.
    """
    (condition,) = as_conditions(condition, 1)
    for name in ("known", "num_lanes", "num_agents"):
        if getattr(condition, name) is not None:
            raise ValueError(f"Condition.{name} is given, but the map decides it here: leave it out")
    if condition.image is not None:
        raise ValueError("Condition.image is given, but tiles take prompts and attributes: leave it out")
    if condition.crop != Crop.CENTERED:
        raise ValueError("Condition.crop is given, but the map decides it here: leave it out")
    if condition.streams:
        raise ValueError("Condition.streams is given, but tiles take prompts and attributes: leave it out")
    return condition


def _known_window(map: Map, pose: WindowPose, ego: bool) -> tuple[KnownWindow, Coverage]:
    trimmed = trim_tails(map, pose)
    scene = cut_window(trimmed, pose, ego=ego)
    if scene.crop != Crop.PARTITIONED:  # what is known ahead stays whole
        trimmed, scene = map, cut_window(map, pose, ego=ego)
    opened = (pose.x, pose.y, pose.yaw) if scene.crop == Crop.PARTITIONED else None
    coverage = Coverage(map, opened)
    ends = ends_in_window(coverage.open_ends(trimmed), pose)
    return KnownWindow(pose, trimmed, scene, ends, DeadTurns(trimmed, ends, pose.x, pose.y)), coverage


def _joined(map: Map, window: KnownWindow, best: TileCandidate, attempts: int, prompt: str) -> Map:
    """The map with the candidate, its tile, and the seams with the tiles that it meets."""
    pose = window.pose
    tile = MapTile(
        x=pose.x,
        y=pose.y,
        z=pose.z,
        yaw=pose.yaw,
        status=TileStatus.INCOMPLETE if best.faults else TileStatus.COMPLETE,
        attempts=attempts,
        prompt=prompt,
        fault="; ".join(best.faults),
        lane_ids=tuple(lane.id for lane in best.map.lanes),
        agent_ids=best.map.agent_ids,
    )
    if not best.connections:
        fault = "no candidate continues a lane"
        missing = dataclasses.replace(tile, status=TileStatus.MISSING, fault=fault, lane_ids=(), agent_ids=())
        return dataclasses.replace(map, tiles=(*map.tiles, missing))
    addition = dataclasses.replace(best.map, tiles=(tile,))
    map = dataclasses.replace(window.map, lanes=tuple(best.moved.get(lane.id, lane) for lane in window.map.lanes))
    joined = join_maps(map, addition, best.connections, _seams(window, best, len(map.tiles)))
    return without_turns(joined, set(best.dead_lane_ids))


def _seams(window: KnownWindow, best: TileCandidate, number: int) -> list[MapSeam]:
    """One seam for every older tile that the new one, of this number, is connected to."""
    start, end = window.pose.to_map(np.array([[0.0, -HALF, 0.0], [0.0, HALF, 0.0]]))[:, :2]
    tile_of = {item: row for row, tile in enumerate(window.map.tiles) for item in tile.lane_ids}
    pairs: dict[int, list[tuple[str, str]]] = {}
    for pair in best.connections:
        older = [tile_of[item] for item in pair if item in tile_of]
        if older:
            pairs.setdefault(older[0], []).append(pair)
    line = (float(start[0]), float(start[1])), (float(end[0]), float(end[1]))
    return [
        MapSeam(tiles=(older, number), start=line[0], end=line[1], connections=tuple(connections))
        for older, connections in sorted(pairs.items())
    ]
