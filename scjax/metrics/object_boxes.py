"""Objects of a log as boxes over time, and signed distances between them."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import AgentType, Log
from scjax.scene.agent_sizes import CLASS_SIZES

FAR = 1e10
"""Distance to the nearest object where there is no other one [m]."""

CORNER_ROUNDING = 0.7
"""Radius of the corners of a box / half of its shorter side: 0 is a box, 1 a capsule."""

_OTHER_SIZE = (1.0, 1.0)  # m


@dataclasses.dataclass(frozen=True)
class ObjectBoxes:
    """Boxes of N objects at T steps.

    Attributes:
      positions: centers [m].
      headings: [rad].
      valid: whether the object is there.
      half: half of length and width [m].
      types: ``AgentType`` or ``OTHER_OBJECT``.
      dt: duration of a step [s].
    """

    positions: Float64[np.ndarray, "N T 2"]
    headings: Float64[np.ndarray, "N T"]
    valid: Bool[np.ndarray, "N T"]
    half: Float64[np.ndarray, "N 2"]
    types: Int[np.ndarray, " N"]
    dt: float


def object_boxes(log: Log) -> ObjectBoxes:
    """All objects of a log; sizes that it does not know are those of their class.

    Raises:
      ValueError: the log has fewer than two steps, or NaN at a valid step.
    """
    if log.num_steps < 2:
        raise ValueError(f"the log has {log.num_steps} step: motion needs at least two")
    positions = log.positions[..., :2]
    broken = log.valid & ~(np.isfinite(positions).all(-1) & np.isfinite(log.headings))
    if broken.any():
        row, step = np.argwhere(broken)[0].tolist()
        raise ValueError(f"object {log.object_ids[row]} has NaN or infinity at step {step}: mark the step as not valid")
    usual = [CLASS_SIZES[AgentType(kind)][:2] if kind >= 0 else _OTHER_SIZE for kind in log.object_types.tolist()]
    sizes = np.where(np.isfinite(log.sizes[:, :2]), log.sizes[:, :2], np.array(usual).reshape(-1, 2))
    return ObjectBoxes(positions, log.headings, log.valid, sizes / 2, log.object_types, log.dt)


def corner_points(
    centers: Float64[np.ndarray, "*boxes 2"],
    headings: Float64[np.ndarray, "*boxes"],
    half: Float64[np.ndarray, "*boxes 2"],
) -> Float64[np.ndarray, "*boxes 4 2"]:
    """Corners of boxes, counter-clockwise from the front left [m]; ``half`` is half of length and width [m]."""
    ahead = np.stack([np.cos(headings), np.sin(headings)], -1) * half[..., :1]
    left = np.stack([-np.sin(headings), np.cos(headings)], -1) * half[..., 1:]
    return centers[..., None, :] + np.stack([ahead + left, left - ahead, -ahead - left, ahead - left], -2)


def signed_box_distances(
    centers: tuple[Float64[np.ndarray, "pairs 2"], Float64[np.ndarray, "pairs 2"]],
    headings: tuple[Float64[np.ndarray, " pairs"], Float64[np.ndarray, " pairs"]],
    half: tuple[Float64[np.ndarray, "pairs 2"], Float64[np.ndarray, "pairs 2"]],
    rounding: float = CORNER_ROUNDING,
) -> Float64[np.ndarray, " pairs"]:
    """Signed distance of box k of the first side to box k of the second [m]; negative where they overlap.

    Boxes are shrunk to cores, and the distance of the cores is reduced by what they were shrunk: corners are round.
    Cores that overlap have minus the smallest shift that parts them.

    Args:
      centers, headings, half: of the two sides; half of length and width [m].
      rounding: as ``CORNER_ROUNDING``.
    """
    shrunk = [rounding * side.min(-1) for side in half]
    cores = [side - radius[:, None] for side, radius in zip(half, shrunk, strict=True)]
    offset = centers[1] - centers[0]
    apart = np.full(len(offset), np.inf)  # of corners of one core to the other core
    depth = np.full(len(offset), np.inf)  # smallest overlap along the sides of either core
    for first, second, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        cos, sin = np.cos(headings[first]), np.sin(headings[first])
        x = sign * (offset[:, 0] * cos + offset[:, 1] * sin)
        y = sign * (offset[:, 1] * cos - offset[:, 0] * sin)
        turn = headings[second] - headings[first]
        along, across = np.cos(turn), np.sin(turn)
        length, width = cores[second].T
        limit_x, limit_y = cores[first].T
        for forward, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            corner_x = x + forward * length * along - left * width * across
            corner_y = y + forward * length * across + left * width * along
            apart = np.minimum(
                apart, np.hypot(np.maximum(np.abs(corner_x) - limit_x, 0), np.maximum(np.abs(corner_y) - limit_y, 0))
            )
        reach_x = length * np.abs(along) + width * np.abs(across) + limit_x - np.abs(x)
        reach_y = length * np.abs(across) + width * np.abs(along) + limit_y - np.abs(y)
        depth = np.minimum(depth, np.minimum(reach_x, reach_y))
    return np.where(depth > 0, -depth, apart) - shrunk[0] - shrunk[1]


def nearest_object_distances(
    boxes: ObjectBoxes, rows: Int[np.ndarray, " rows"], apart: Float64[np.ndarray, "rows N T"]
) -> Float64[np.ndarray, "rows T"]:
    """Signed distance of some objects to the nearest other one [m]; ``FAR`` without another one.

    Args:
      rows: the objects.
      apart: of ``center_distances``.
    """
    outer = np.linalg.norm(boxes.half, axis=-1)  # circles around and inside the boxes bound their distances
    inner = boxes.half.min(-1)
    highest = (apart - (inner[rows, None] + inner)[..., None]).min(1, initial=FAR)
    lowest = apart - (outer[rows, None] + outer)[..., None]
    row, other, step = np.nonzero((lowest <= highest[:, None]) & np.isfinite(apart))
    own = rows[row]
    distance = signed_box_distances(
        (boxes.positions[own, step], boxes.positions[other, step]),
        (boxes.headings[own, step], boxes.headings[other, step]),
        (boxes.half[own], boxes.half[other]),
    )
    nearest = np.full((len(rows), boxes.valid.shape[1]), FAR)
    np.minimum.at(nearest, (row, step), distance)
    return nearest


def center_distances(boxes: ObjectBoxes, rows: Int[np.ndarray, " rows"]) -> Float64[np.ndarray, "rows N T"]:
    """Distance of the centers of some objects to those of all [m]; inf where one is absent, and to itself."""
    x, y = np.moveaxis(np.where(boxes.valid[..., None], boxes.positions, np.inf), -1, 0)
    with np.errstate(invalid="ignore"):
        apart = np.hypot(x[rows, None] - x, y[rows, None] - y)
    apart[np.isnan(apart)] = np.inf
    apart[np.arange(len(rows)), rows] = np.inf
    return apart
