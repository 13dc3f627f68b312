"""Scenes from the files that a user has: scjax's own, and maps and recordings in the formats of others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from scjax.cli.output import say

if TYPE_CHECKING:
    from scjax.scene import Log, Map, Scene


def read_scenes(path: str | Path, *, strict: bool = False) -> list[Scene]:
    """All scenes of a file, without padding. Of a log or map the scene around its first pose is taken.

    What looks wrong in them is said on stderr.

    Args:
      strict: refuse what looks wrong.

    Raises:
      ValueError: names the file and what is wrong with it.
    """
    return checked_scenes(scenes_of_content(read_content(path), path), path, strict=strict)


def checked_scenes(scenes: list[Scene], path: str | Path, *, strict: bool) -> list[Scene]:
    """The scenes themselves; what looks wrong in them is said on stderr, or refused if ``strict`` (ValueError)."""
    from scjax.metrics.plausibility import scene_warnings

    for number, scene in enumerate(scenes):
        for warning in scene_warnings(scene):
            text = f"{path}, scene {number}: {warning}"
            if strict:
                raise ValueError(f"{text} (--strict refuses it)")
            say(f"scjax: warning: {text}")
    return scenes


def read_content(path: str | Path) -> Scene | Log | Map:
    """What a file of any format holds.

    Raises:
      ValueError: names the file and what is wrong with it.
    """
    from scjax.data.imports import read_any

    if not str(path).strip():
        raise ValueError("FILE is empty: give the name of a file")
    try:
        return read_any(path)
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror or error})") from error


def scenes_of_content(content: Scene | Log | Map, path: str | Path) -> list[Scene]:
    """All scenes in the content of a file, without padding; of a log or map, the one around its first pose.

    Raises:
      ValueError: there are none; names the file.
    """
    import numpy as np

    from scjax.scene import Map, Scene, map_to_log, unpadded

    if not isinstance(content, Scene):
        return [_scene_of_log(map_to_log(content) if isinstance(content, Map) else content, path)]
    if not content.batch_shape:
        return [unpadded(content)]
    count = int(np.prod(content.batch_shape))
    if not count:
        raise ValueError(f"{path} holds no scenes")
    axes = len(content.batch_shape)
    flat = {name: value.reshape(count, *value.shape[axes:]) for name, value in content.to_dict().items()}
    batch = content.replace(**flat)
    return [unpadded(batch[k]) for k in range(count)]


def _scene_of_log(log: Log, path: str | Path) -> Scene:
    """The scene around the first vehicle that drives on a lane; of a map without one, around a place on a lane."""
    from scjax.data.lane_graph import build_graph, index_segments
    from scjax.data.lane_poses import lane_poses
    from scjax.data.log_crop import crop_log
    from scjax.data.tiles import find_poses

    graph = build_graph(log)
    index = index_segments(graph)
    poses = find_poses(log, index, max_poses=1)
    if poses:
        say(f"scjax: {path}: the scene around object {poses[0].object_index} at step {poses[0].step}")
    else:
        log, _, poses = lane_poses(log, graph, index, 1)
        if not poses:
            raise ValueError(f"{path}: it has no vehicle on a lane to take as ego, and no lane long enough for one")
        say(f"scjax: {path}: no vehicle on a lane: a standing ego at x {poses[0].x:.1f}, y {poses[0].y:.1f}")
    return crop_log(log, poses[0].step, poses[0].object_index)


strict_option = click.option("--strict", is_flag=True, help="Refuse scenes that look wrong, instead of a warning.")
