"""Poses of cameras beside pictures: a JSON file from which other programs can place what they draw."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from scjax.camera.camera import Camera
from scjax.camera.rig import CameraPoses
from scjax.camera.rig_file import camera_document
from scjax.scene import Log
from scjax.scene.files import write_text

POSES_FORMAT, POSES_VERSION = "scjax-camera-poses", 1


@runtime_checkable
class PosedCamera(Protocol):
    """A renderer of a log, or anything else with a camera that has a pose at each step."""

    log: Log
    camera: Camera
    poses: CameraPoses


def write_camera_poses(renderers: Sequence[PosedCamera], steps: Sequence[int] | np.ndarray, path: str | Path) -> None:
    """Writes intrinsics, and the pose at each step in the frame of the log, of cameras that look at one log.

    ``rotations`` are lists of rows; their columns are the axes of the camera (x right, y down, z ahead).
    """
    steps = np.asarray(steps, int)
    cameras = []
    for renderer in renderers:
        document = camera_document(renderer.camera)
        del document["rotation"], document["translation"]
        document["rotations"] = np.round(renderer.poses.rotations[steps], 9).tolist()
        document["translations"] = np.round(renderer.poses.translations[steps], 6).tolist()
        cameras.append(document)
    content = {
        "format": POSES_FORMAT,
        "version": POSES_VERSION,
        "steps": steps.tolist(),
        "timestamps": renderers[0].log.timestamps[steps].tolist(),
        "cameras": cameras,
    }
    write_text(Path(path), json.dumps(content, indent=None) + "\n")
