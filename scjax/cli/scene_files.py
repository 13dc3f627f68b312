"""Scenes from the files that a user has: scjax's own npz and JSON, logs, and recorded scenes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from scjax.cli.output import say

if TYPE_CHECKING:
    from scjax.scene import Log, Scene

_OTHER_FORMATS = {
    ".xodr": "OpenDRIVE",
    ".xosc": "OpenSCENARIO",
    ".osm": "Lanelet2",
    ".xml": "CommonRoad or SUMO",
    ".pkl": "ScenarioNet or Waymax",
    ".tfrecord": "Waymo",
    ".parquet": "Argoverse 2",
}
_READ = (
    "scjax reads .npz and .json scenes (docs/scene-json.md), logs (.npz), and recorded scenes (.json.gz of schema "
    "scene-json-1)"
)


def read_scenes(path: str | Path, *, strict: bool = False) -> list[Scene]:
    """All scenes of a file, without padding. Of a log the scene around its first pose is taken.

    What looks wrong in them is said on stderr.

    Args:
      strict: refuse what looks wrong.

    Raises:
      ValueError: names the file and what is wrong with it.
    """
    from scjax.metrics.plausibility import scene_warnings

    if not str(path).strip():
        raise ValueError("FILE is empty: give the name of a file")
    path = Path(path)
    if not path.name.endswith((".npz", ".json", ".json.gz")):
        other = _OTHER_FORMATS.get(path.suffix)
        kind = f"files of {other} have no reader yet" if other else f"{path.suffix or 'such'} files have no reader"
        raise ValueError(f"{path}: {kind}: {_READ}")
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file" if not path.exists() else f"{path}: is a folder, not a file")
    try:
        scenes = _read(path)
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror or error})") from error
    for number, scene in enumerate(scenes):
        for warning in scene_warnings(scene):
            text = f"{path}, scene {number}: {warning}"
            if strict:
                raise ValueError(f"{text} (--strict refuses it)")
            say(f"scjax: warning: {text}")
    return scenes


def _read(path: Path) -> list[Scene]:
    from scjax.scene import io, load_log, unpadded

    if path.name.endswith(".json.gz"):
        from scjax.data.readers.scene_json import read_log

        return [_scene_of_log(read_log(path), path)]
    if path.suffix == ".npz" and _is_log(path):
        return [_scene_of_log(load_log(path), path)]
    scene = io.load_npz(path) if path.suffix == ".npz" else io.load_json(path)
    if not scene.batch_shape:
        return [unpadded(scene)]
    import numpy as np

    count = int(np.prod(scene.batch_shape))
    if not count:
        raise ValueError(f"{path} holds no scenes")
    axes = len(scene.batch_shape)
    flat = scene.replace(**{name: value.reshape(count, *value.shape[axes:]) for name, value in scene.to_dict().items()})
    return [unpadded(flat[k]) for k in range(count)]


def _is_log(path: Path) -> bool:
    """Whether an npz file has the header of a log; names of arrays stand in it uncompressed."""
    return b"header.npy" in path.read_bytes()


def _scene_of_log(log: Log, path: Path) -> Scene:
    from scjax.data.lane_graph import build_graph, index_segments
    from scjax.data.log_crop import crop_log
    from scjax.data.tiles import find_poses

    poses = find_poses(log, index_segments(build_graph(log)), max_poses=1)
    if not poses:
        raise ValueError(f"{path}: it has no vehicle on a lane to take as ego")
    say(f"scjax: {path}: the scene around object {poses[0].object_index} at step {poses[0].step}")
    return crop_log(log, poses[0].step, poses[0].object_index)


strict_option = click.option("--strict", is_flag=True, help="Refuse scenes that look wrong, instead of a warning.")
