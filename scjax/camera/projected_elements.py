"""Lines and boxes as they lie in a picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int, UInt8


class ProjectedLines(NamedTuple):
    """Lines in the picture, in the order in which they are drawn."""

    ends: Float64[np.ndarray, "n 2 2"]
    inverse_depths: Float64[np.ndarray, "n 2"]
    colors: UInt8[np.ndarray, "n 3"]
    widths: Int[np.ndarray, " n"]
    owners: Int[np.ndarray, " n"]  # index of the line or box of the world


class ProjectedBoxes(NamedTuple):
    """Boxes in the picture, from the farthest to the nearest.

    Attributes:
      lines: edges and marks of all boxes, those of one box together.
      owners: index of the box in the world, for each box in the picture.
      starts: of the lines of each box, and the end of all.
      in_front: lines that belong to a face that looks at the camera.
      faces: visible faces: corners in the picture and in the frame of the camera, and the box in the picture that each
        belongs to.
    """

    lines: ProjectedLines
    owners: Int[np.ndarray, " boxes"]
    starts: Int[np.ndarray, " starts"]
    in_front: Bool[np.ndarray, " n"]
    faces: Float64[np.ndarray, "m 9 2"]
    face_corners: Float64[np.ndarray, "m 4 3"]
    face_boxes: Int[np.ndarray, " m"]
