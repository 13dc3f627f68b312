"""Real scenes that are cut in two: the lanes of both halves find each other again."""

from __future__ import annotations

import numpy as np

import scjax
from scjax.data.readers.scene_json import read_log
from scjax.data.token_order import known_half
from scjax.outpainting.coverage import Coverage
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.exits import ends_in_window
from scjax.outpainting.tile_candidate import tile_candidate
from scjax.outpainting.window import KnownWindow, WindowPose
from scjax.scene import Crop, Link, Scene, permute, scene_to_map
from scjax.scene.map_forms import log_to_map

SCENES = 40  # 300: 1,494 links cut, 1,490 found, 6 others. Where a new lane was cut, 4 links are mistaken for another
EGOS = 3
"""Agents of a log around which scenes are cut."""


def links_cut_and_found(scene: Scene) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """Links across x = 0 of a partitioned scene as rows of lanes, and those found when both halves are apart."""
    lanes = np.asarray(scene.lanes, np.float64)
    is_known = known_half(lanes[..., :2], np.zeros((0, 2))).lanes
    known_rows, new_rows = np.flatnonzero(is_known), np.flatnonzero(~is_known)
    known = permute(scene, np.arange(1), known_rows)
    whole = permute(scene, np.arange(1), np.concatenate([known_rows, new_rows]))
    pose, map = WindowPose(0.0, 0.0, 0.0, 0.0), scene_to_map(known)
    opened = Coverage(map, (0.0, 0.0, 0.0))
    ends = ends_in_window(opened.open_ends(map), pose)
    window = KnownWindow(pose, map, known, ends, DeadTurns(map, ends, 0.0, 0.0))
    candidate = tile_candidate(whole, window, opened, "new")
    row_of = {f"0.lane-{k}": int(row) for k, row in enumerate(known_rows)}
    for lane in candidate.map.lanes:
        apart = np.abs(lanes[new_rows][:, [0, -1], :2] - lane.points[[0, -1], :2]).sum((1, 2))
        row_of[lane.id] = int(new_rows[apart.argmin()])
    cut = {(int(a), int(b)) for a, b in np.argwhere(np.asarray(scene.links) == Link.PREDECESSOR)}
    cut = {(a, b) for a, b in cut if is_known[a] != is_known[b]}
    return cut, {(row_of[a], row_of[b]) for a, b in candidate.connections}


def test_real_scenes_cut_in_two_are_linked_again(data_dir):
    cut = found = wrong = scenes = 0
    for path in sorted((data_dir / "womd").glob("*.json.gz")):
        log = read_log(path)
        map = log_to_map(log, log.num_steps // 2)
        for agent in map.agent_ids[:EGOS]:
            try:
                scene = scjax.crop_map(map, agent=agent, crop=Crop.PARTITIONED)
            except ValueError:  # not on a road
                continue
            before, after = links_cut_and_found(scene)
            scenes += bool(before)
            cut, found, wrong = cut + len(before), found + len(before & after), wrong + len(after - before)
        if scenes >= SCENES:
            break
    assert found >= 0.99 * cut > 0
    assert wrong <= 0.01 * cut
