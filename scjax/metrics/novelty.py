"""How far scenes are from the scenes a model was trained on: distance between lane graphs, nearest training tile."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from scjax.metrics.lanes import lane_lengths, places, segments
from scjax.metrics.placement import match
from scjax.metrics.pooling import Ratios, singles
from scjax.scene import Scene

SPACING = 2.0  # metres between lane points
DIRECTION = 2.0  # metres that a turn of the direction by one radian is worth; opposite directions are 4 m apart
LONGEST = 4000.0  # metres of lanes a tile (real ones hold up to 1,700) beyond which points lie farther apart
_COARSE = 6.0  # metres between lane points in the first pass over the bank
_KEPT = 0.05  # share of the bank, and the least number of tiles, that the first pass leaves over
_KEPT_LEAST = 200
_FINALISTS = 4  # tiles left over by the second pass, in float32; their distances are computed in float64


@dataclasses.dataclass(frozen=True)
class Nearest:
    """The training tile whose lanes are nearest to a scene's.

    Attributes:
      tile: its index in the bank.
      lane_distance: as ``lane_distance`` [m].
      match: ``placement.match`` of the scene's agents with the tile's as reference.
    """

    tile: int
    lane_distance: float
    match: Ratios


def lane_points(scene: Scene, spacing: float = SPACING) -> Float64[np.ndarray, "points 4"]:
    """Points of one scene's lanes, each standing for about 2 m: x, y, and their unit direction times ``DIRECTION``.

    A lane of xy length s has max(1, round(s / spacing)) points in the middles of equal parts. Scenes whose lanes run
    wild have as many points as 4 km of lanes would.
    """
    length = lane_lengths(scene)
    spacing *= max(1.0, length.sum() / LONGEST)
    count = np.maximum(1, np.round(length / spacing)).astype(int)
    first = np.cumsum(count) - count
    middle = np.arange(count.sum()) - np.repeat(first, count) + 0.5
    arc = np.repeat(np.cumsum(length) - length, count) + middle * np.repeat(length / count, count)
    points, direction = places(segments(scene), arc)
    return np.concatenate([points[:, :2], DIRECTION * direction], 1)


def lane_distance(first: Scene, second: Scene) -> float:
    """Symmetric mean Chamfer distance between the lanes of two single scenes, direction included [m].

    With rho(p, q) = sqrt(|xy_p - xy_q|^2 + (2 m)^2 |u_p - u_q|^2) over the ``lane_points`` (u: unit direction): the
    mean, over the points of either scene, of rho to the nearest point of the other; then the mean of both. 0 for equal
    lanes in any order; inf if only one of the scenes has lanes. The frame is the ego's: nothing is aligned.
    """
    return _chamfer(*(_tree(lane_points(scene)) for scene in (first, second)))


def nearest_tiles(scenes: Scene | Iterable[Scene], bank: Scene | Iterable[Scene]) -> Iterator[Nearest]:
    """The nearest tile of ``bank`` for each of ``scenes``, in order.

    A first pass compares with every tile at points 6 m apart, a second one the best 5 %, at least 200, at 2 m.

    Raises:
      ValueError: if the bank is empty.
    """
    tiles = list(singles(bank))
    if not tiles:
        raise ValueError("there are no training tiles to compare with: the bank is empty")
    coarse, fine = ([_Products(lane_points(tile, spacing)) for tile in tiles] for spacing in (_COARSE, SPACING))
    keep = max(_KEPT_LEAST, math.ceil(_KEPT * len(tiles)))
    for scene in singles(scenes):
        points = lane_points(scene)
        kept = _best(_Products(lane_points(scene, _COARSE)), coarse, list(range(len(tiles))), keep)
        finalists = _best(_Products(points), fine, kept, _FINALISTS)
        exact = [_chamfer(_tree(points), _tree(lane_points(tiles[tile]))) for tile in finalists]
        best = int(np.argmin(np.array(exact)))
        tile = finalists[best]
        yield Nearest(tile=tile, lane_distance=exact[best], match=match(tiles[tile], scene))


def _tree(points: np.ndarray) -> KDTree | None:
    return KDTree(points) if len(points) else None


def _chamfer(first: KDTree | None, second: KDTree | None) -> float:
    if first is None or second is None:
        return 0.0 if first is second else math.inf
    there, back = np.asarray(second.query(first.data)[0]), np.asarray(first.query(second.data)[0])
    return float((there.mean() + back.mean()) / 2)


class _Products:
    """Points in the forms of which |p - q|^2 is a single matrix product: [p, |p|^2, 1] . [-2 q, 1, |q|^2]."""

    def __init__(self, points: np.ndarray):
        square, one = (points**2).sum(-1, keepdims=True), np.ones((len(points), 1))
        self.left = np.concatenate([points, square, one], 1).astype(np.float32)
        self.right = np.ascontiguousarray(np.concatenate([-2 * points, one, square], 1).astype(np.float32).T)


def _best(scene: _Products, bank: Sequence[_Products], candidates: Sequence[int], count: int) -> list[int]:
    """The ``count`` nearest of the candidates, in bank order; distances in float32 are right to about 0.02 m."""
    rows = len(scene.left)
    buffer = np.empty(rows * max(len(bank[tile].left) for tile in candidates), np.float32)
    distances = np.full(len(candidates), np.inf)
    for index, tile in enumerate(candidates):
        columns = len(bank[tile].left)
        if not rows or not columns:
            distances[index] = 0.0 if rows == columns else np.inf
            continue
        square = buffer[: rows * columns].reshape(rows, columns)
        np.matmul(scene.left, bank[tile].right, out=square)
        there, back = square.min(1), square.min(0)
        distances[index] = (np.sqrt(there.clip(0)).mean() + np.sqrt(back.clip(0)).mean()) / 2
    return sorted(candidates[index] for index in np.argsort(distances, kind="stable")[:count])
