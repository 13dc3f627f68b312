"""Pictures of the records of synthetic worlds: what a dashcam on each ego sees, with targets of their cells."""

from __future__ import annotations

import dataclasses
import functools
import io
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8
from tqdm import tqdm

from scjax.camera.dashcam import DashcamFrame, DashcamRenderer, Look, random_look
from scjax.camera.dashcam.cell_targets import CellTargets, cell_targets
from scjax.camera.raster import require_opencv
from scjax.camera.rig import Rig
from scjax.camera.standard_view import STANDARD_HEIGHT, standard_camera
from scjax.data import records
from scjax.data.build import load_manifest
from scjax.data.records import SceneRecord, read_record
from scjax.data.window_images import picture_name
from scjax.data.workers import WorkerPool
from scjax.scene import Crop, Log
from scjax.scene.files import locked_folder, remove_stale_parts, write_file
from scjax.synthetic.recording import to_log
from scjax.synthetic.world import make_world

CELLS = (28, 28)
"""Rows and columns of cells of pictures."""

_QUALITY = 92  # of JPEG
_SAMPLES = 2  # of a pixel, to each side
_FOCAL_SPREAD = 0.015  # standard deviation of the logarithm of a picture's focal length: calibrations are not exact
_HEIGHT_SPREAD, _HEIGHTS = 0.15, (1.1, 2.4)  # of the logarithm of the camera's height, and limits [m]
_MOUNT_SHARE = 0.25  # of the pitch, roll and height by which looks differ that calibrations do not know of
_LOOKS = 100_000  # between the numbers of a world's looks
_LEVEL = {"lens": 0.0, "raise_by": 0.0, "pitch_by": 0.0, "roll_by": 0.0}


class RecordPicture(NamedTuple):
    """The picture of a record.

    Attributes:
      row: of the record in its split.
      frame: the picture; targets: of its cells.
    """

    row: int
    frame: DashcamFrame
    targets: CellTargets


def render_records(folder: str | Path, out: str | Path, *, workers: int = 0, progress: bool = True) -> int:
    """Renders a picture for every record of a folder of synthetic worlds; those that are there stay.

    OUT receives SPLIT-ROW.jpg and SPLIT-ROW.npz (fields of ``CellTargets``) for each record.

    Returns:
      The number of new pictures.

    Raises:
      ValueError: a record is of no synthetic world, or another process uses ``out``.
    """
    require_opencv()
    out, made = Path(out), 0
    splits = load_manifest(folder)["splits"]
    with locked_folder(out):
        remove_stale_parts(out)
        tasks = [
            (str(folder), split, name, rows, str(out))
            for split in sorted(splits, reverse=True)
            if splits[split]["records"]
            for name, rows in _rows_by_world(folder, split).items()
            if not all((out / f"{picture_name(split, row)}.npz").is_file() for row in rows)
        ]
        total = sum(len(task[3]) for task in tasks)
        with (
            tqdm(total=total, desc="pictures", unit="picture", disable=not progress) as bar,
            WorkerPool(workers, chunk_size=4) as run,
        ):
            for count in run(_write_world, tasks):
                bar.update(count)
                made += count
    return made


def world_pictures(stored: Any, name: str, rows: list[int]) -> Iterator[RecordPicture]:
    """Pictures of the records ``rows`` of one world."""
    _, seed, number = name.rsplit("-", 2)
    log = to_log(make_world(int(seed), int(number)))
    rng = np.random.default_rng([int(seed), int(number), 0xDA])
    base = dataclasses.replace(random_look(int(seed) * _LOOKS + int(number)), **_LEVEL)
    rig = _standard_rig(rng)
    renderer: DashcamRenderer | None = None
    for row in rows:
        record = read_record(stored, row)
        look = _look_of(base, rng)
        if renderer is None:
            renderer = DashcamRenderer(log, rig, actor=record.object_index, look=base, supersampling=_SAMPLES)
        own = renderer.carried_by(record.object_index, look)
        frame = own.frame(record.step)
        yield RecordPicture(row, frame, _targets(own, frame, log, record))


def _targets(renderer: DashcamRenderer, frame: DashcamFrame, log: Log, record: SceneRecord) -> CellTargets:
    """Targets in the frame of the record's ego."""
    step, ego = record.step, record.object_index
    cos, sin = np.cos(log.headings[ego, step]), np.sin(log.headings[ego, step])
    turn = np.array([[cos, sin], [-sin, cos]])
    offsets = (log.positions[:, step, :2] - log.positions[ego, step, :2]) @ turn.T
    relative = log.headings[:, step] - log.headings[ego, step]
    boxes = np.column_stack([offsets, np.cos(relative), np.sin(relative), log.sizes[:, :2]])
    rotation = renderer.poses.rotations[step].copy()
    rotation[:2] = turn @ rotation[:2]
    position = renderer.poses.translations[step] - log.positions[ego, step]
    position[:2] = turn @ position[:2]
    scene = records.sample_scene(record, Crop.FORWARD)
    return cell_targets(frame, renderer.pixel_rays, (rotation, position), boxes, scene, CELLS)


def _standard_rig(rng: np.random.Generator) -> Rig:
    """The camera of standard views at some height, with nearly its focal length; it does not depend on the carrier."""
    height = float(np.clip(STANDARD_HEIGHT * np.exp(rng.normal(0, _HEIGHT_SPREAD)), *_HEIGHTS))
    camera = standard_camera(height)
    intrinsic = camera.intrinsic.copy()
    intrinsic[[0, 1], [0, 1]] *= np.exp(rng.normal(0, _FOCAL_SPREAD))
    return Rig(name="standard", cameras=(dataclasses.replace(camera, intrinsic=intrinsic),))


def _look_of(base: Look, rng: np.random.Generator) -> Look:
    """The look of a world with another exposure and noise, and a mount that differs a little."""
    own = random_look(int(rng.integers(2**31)))
    mount = {name: _MOUNT_SHARE * getattr(own, name) for name in ("raise_by", "pitch_by", "roll_by")}
    names = ("exposure", "contrast", "vignette", "noise")
    return dataclasses.replace(base, **{name: getattr(own, name) for name in names}, **mount)


@functools.lru_cache(maxsize=2)
def _stored(folder: str, split: str) -> Any:
    return records.open_records(folder, split)


def _rows_by_world(folder: str | Path, split: str) -> dict[str, list[int]]:
    """Name of a world -> rows of its records."""
    stored, rows = _stored(str(folder), split), defaultdict(list)
    for row in range(len(stored)):
        name = read_record(stored, row).scene_id
        if len(name.rsplit("-", 2)) != 3:
            raise ValueError(f"{folder}: {name} is no synthetic world: render records of scjax data synthetic")
        rows[name].append(row)
    return dict(rows)


def _write_world(task: tuple[str, str, str, list[int], str]) -> int:
    folder, split, name, rows, out = task
    cv2 = require_opencv()
    cv2.setNumThreads(1)
    for picture in world_pictures(_stored(folder, split), name, rows):
        stem = picture_name(split, picture.row)
        _, encoded = cv2.imencode(".jpg", picture.frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **picture.targets._asdict())
        for ending, data in (("jpg", encoded.tobytes()), ("npz", buffer.getvalue())):
            write_file(Path(out, f"{stem}.{ending}"), functools.partial(_write, data), clean=False)
    return len(rows)


def _write(data: bytes, file: Any) -> None:
    file.write(data)


def read_rendered(folder: str | Path, split: str, row: int) -> tuple[UInt8[np.ndarray, "height width 3"], CellTargets]:
    """A picture of ``render_records`` and its targets.

    Raises:
      ValueError: it is not there or damaged.
    """
    stem = Path(folder) / picture_name(split, row)
    pixels = require_opencv().imread(f"{stem}.jpg")
    try:
        with np.load(f"{stem}.npz") as arrays:
            targets = CellTargets(**{name: arrays[name] for name in CellTargets._fields})
    except (OSError, KeyError, ValueError) as error:
        raise ValueError(f"{stem}.npz: cannot be read ({error}): run scjax data dashcam again") from error
    if pixels is None:
        raise ValueError(f"{stem}.jpg: cannot be read: run scjax data dashcam again")
    return pixels[..., ::-1], targets
