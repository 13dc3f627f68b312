"""Rigs in JSON files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from msgspec import Struct, field

from scjax.camera.camera import Camera
from scjax.camera.distortion import NO_DISTORTION
from scjax.camera.rig import Rig
from scjax.scene.document import parse_document
from scjax.scene.files import read_limited, write_text

RIG_FORMAT, RIG_VERSION = "scjax-rig", 1
_CURE = "write it with scjax.camera.write_rig, or see docs/camera.md"
Triple = tuple[float, float, float]


class RigHeader(Struct):
    """What is read first of a file."""

    format: str = ""
    version: int = 0


class CameraDocument(Struct, forbid_unknown_fields=True):
    """A camera of a rig; fields as of ``Camera``."""

    name: str
    width: int
    height: int
    intrinsic: tuple[Triple, Triple, Triple]
    rotation: tuple[Triple, Triple, Triple]
    translation: Triple
    distortion: tuple[float, float, float, float, float] = NO_DISTORTION


class RigDocument(Struct, forbid_unknown_fields=True):
    """A rig; fields as of ``Rig``. Lengths are in m; matrices are lists of rows."""

    cameras: list[CameraDocument]
    format: str = RIG_FORMAT
    version: int = RIG_VERSION
    name: str = "rig"
    origin: Triple = field(default=(0.0, 0.0, 0.0))
    carrier_size: Triple | None = None


def read_rig(path: str | Path) -> Rig:
    """Reads what ``write_rig`` wrote, or what people write by the same schema.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: naming the file, and the field that is missing, of another type or out of its range.
    """
    return parse_rig(read_limited(path), path)


def parse_rig(data: bytes, name: str | Path) -> Rig:
    """The rig in the content of a file; ``name`` begins all messages."""
    header = parse_document(data, RigHeader, name, _CURE)
    if header.format != RIG_FORMAT:
        raise ValueError(f"{name} is no rig of cameras: its format is {header.format!r}, not {RIG_FORMAT!r}: {_CURE}")
    if header.version != RIG_VERSION:
        raise ValueError(f"{name} has version {header.version} of the format, this scjax reads {RIG_VERSION}: update")
    document = parse_document(data, RigDocument, name, _CURE)
    try:
        size = document.carrier_size
        return Rig(
            name=document.name,
            cameras=tuple(_camera(camera) for camera in document.cameras),
            origin=np.array(document.origin, np.float64),
            carrier_size=None if size is None else np.array(size, np.float64),
        )
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def write_rig(rig: Rig, path: str | Path) -> None:
    """Writes a rig, whole or not at all."""
    content = {
        "format": RIG_FORMAT,
        "version": RIG_VERSION,
        "name": rig.name,
        "origin": rig.origin.tolist(),
        "carrier_size": None if rig.carrier_size is None else rig.carrier_size.tolist(),
        "cameras": [camera_document(camera) for camera in rig.cameras],
    }
    write_text(Path(path), json.dumps(content, indent=1) + "\n")


def camera_document(camera: Camera) -> dict[str, object]:
    """A camera as JSON values."""
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "intrinsic": camera.intrinsic.tolist(),
        "distortion": camera.distortion.tolist(),
        "rotation": camera.rotation.tolist(),
        "translation": camera.translation.tolist(),
    }


def _camera(document: CameraDocument) -> Camera:
    return Camera(
        name=document.name,
        width=document.width,
        height=document.height,
        intrinsic=np.array(document.intrinsic, np.float64),
        rotation=np.array(document.rotation, np.float64),
        translation=np.array(document.translation, np.float64),
        distortion=np.array(document.distortion, np.float64),
    )
