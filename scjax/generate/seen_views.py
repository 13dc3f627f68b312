"""A picture moved, mirrored and enlarged, and where the objects are that the vision network sees in such a view.

The network errs by a pixel or so, and in each view by another one. So views of one picture together say better where
objects are, and whether there are any.

Columns that move turn the rays alone. A picture that is enlarged about the horizon shows the ground as from the same
height with all distances shorter.
"""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, UInt8
from PIL import Image

from scjax.camera.photo import Photo
from scjax.camera.standard_view import standard_camera
from scjax.encoders.dashcam_network import PLACE_SCALE

_EDGE = 8.0  # pixels beside a view, the middles of objects that it still shows
_MOST_HALF = 0.6  # of the distance: half of an object's length along the ray, at most


class ViewChange(NamedTuple):
    """How a view differs from its picture.

    Attributes:
      zoom: enlarged about the horizon, straight ahead.
      shift: to the right, after that [pixels].
      mirrored: left is right, after that.
    """

    zoom: float = 1.0
    shift: int = 0
    mirrored: bool = False


CHANGES = (
    ViewChange(shift=4),  # half of a fine cell
    ViewChange(shift=-4),
    ViewChange(mirrored=True),
    ViewChange(zoom=1.25),
    ViewChange(zoom=1.5),
)
"""Of 400 pictures of other worlds, the picture alone finds 58.4 % of the vehicles up to 40 m within 2 m, with 0.24 a
picture where there is none within 3 m. With the three of no zoom it is 60.3 % and 0.18, with those of zoom 59.7 % and
0.14, with all five 61.5 % and 0.17, at one threshold."""


def changed_views(photo: Photo) -> list[Photo]:
    """The views of a standard view that ``CHANGES`` describe; where they show more than it, its border goes on."""
    return [
        Photo(
            photo.name,
            hashlib.sha256(f"{photo.content} {change}".encode()).hexdigest(),
            lambda change=change: _changed(photo.pixels, change),
        )
        for change in CHANGES
    ]


def _changed(pixels: UInt8[np.ndarray, "height width 3"], change: ViewChange) -> UInt8[np.ndarray, "height width 3"]:
    height, width = pixels.shape[:2]
    margin = abs(change.shift)
    center = standard_camera().intrinsic[:2, 2] + 0.5
    left, top = center - center / change.zoom + margin
    picture = Image.fromarray(np.pad(pixels, ((margin, margin), (margin, margin), (0, 0)), mode="edge"))
    numbers = (1 / change.zoom, 0.0, left - change.shift / change.zoom, 0.0, 1 / change.zoom, top)
    view = np.asarray(picture.transform((width, height), Image.Transform.AFFINE, numbers, Image.Resampling.BICUBIC))
    return np.ascontiguousarray(view[:, ::-1]) if change.mirrored else view


def restore_objects(objects: Float64[np.ndarray, "cells 7"], change: ViewChange) -> Float64[np.ndarray, "cells 7"]:
    """Objects as the picture shows them, from those that a view of it shows (``FineCells.objects``)."""
    camera = standard_camera()
    places, headings, sizes = PLACE_SCALE * objects[:, :2], objects[:, 2:4].copy(), 10 * objects[:, 4:6]
    if change.mirrored:
        places[:, 1], headings[:, 1] = -places[:, 1], -headings[:, 1]
    ahead = places[:, 0] - camera.translation[0]
    places[:, 1] += change.shift / camera.intrinsic[0, 0] * ahead
    if change.zoom != 1.0:
        lengths = np.maximum(np.hypot(*headings.T), 1e-6)[:, None]
        half = (np.abs(headings / lengths) * sizes).sum(1) / 2  # of the object, along the camera's axis
        half = np.minimum(half, _MOST_HALF * ahead)
        # The side that is seen is farther away; the object is no longer.
        places[:, 0] = camera.translation[0] + change.zoom * (ahead - half) + half
        headings = headings * [change.zoom, 1.0]
        headings *= lengths / np.maximum(np.hypot(*headings.T), 1e-6)[:, None]
    return np.concatenate([places / PLACE_SCALE, headings, objects[:, 4:]], 1)


def shows_places(change: ViewChange, places: Float64[np.ndarray, "*b 2"]) -> Bool[np.ndarray, "*b"]:
    """Whether a view shows objects that the picture shows at these places; an enlarged one leaves out its sides."""
    camera = standard_camera()
    ahead = np.maximum(places[..., 0] - camera.translation[0], 1e-6)
    aside = change.zoom * camera.intrinsic[0, 0] * np.abs(places[..., 1]) / ahead
    return np.asarray((change.zoom <= 1.0) | (aside < camera.width / 2 + _EDGE))


def cell_weight(change: ViewChange) -> float:
    """Of a cell of a view, beside those of the picture: enlarged objects have more cells."""
    return 1 / change.zoom**2
