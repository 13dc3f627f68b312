"""Novelty of scenes: distance between lane graphs, and the nearest training tile."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from scjax.metrics.alignment import Pose, register, transform_points
from scjax.metrics.lanes import lane_arc_lengths, lane_segments, points_along
from scjax.metrics.placement import match
from scjax.metrics.pooling import Ratios, singles
from scjax.scene import Scene

SPACING = 2.0  # metres between lane points
DIRECTION = 2.0  # metres per unit difference of directions; opposite directions are 4 m apart
LONGEST = 4000.0  # metres of lanes per tile (real ones: up to 1,700); beyond it, the spacing grows
_COARSE = 6.0  # metres between lane points in the first pass over the bank
_SHORTLIST_SHARE = 0.05  # of the bank, after the first pass
_SHORTLIST_LEAST = 200  # tiles
_TURNS = (0.0, np.deg2rad(8.0), -np.deg2rad(8.0))  # rotations of the scene in the first pass [rad]
_ALIGNED = 64  # tiles that the scene is aligned with
_FAR = np.float32(1e12)  # square metres
# Multiply-adds up to which OpenBLAS stays on the calling thread: its threads are 6 times slower on a busy machine.
_UNTHREADED = 200_000
_FINALISTS = 4  # tiles after the second pass (float32); their distances are computed in float64


@dataclasses.dataclass(frozen=True)
class Nearest:
    """The training tile whose lanes are nearest to a scene's.

    Attributes:
      tile: index in the bank.
      lane_distance: ``lane_distance`` of scene and tile [m].
      match: ``placement.match`` with the tile as reference.
      pose: x, y [m], yaw [rad] that moves the scene onto the tile; zero without alignment.
    """

    tile: int
    lane_distance: float
    match: Ratios
    pose: Pose


def lane_points(scene: Scene, spacing: float = SPACING) -> Float64[np.ndarray, "points 4"]:
    """Points on the lanes of one scene, about one per 2 m: x, y, and the unit direction times ``DIRECTION``.

    A lane of xy length s has max(1, round(s / spacing)) points, at the middles of equal parts. The spacing grows in
    scenes with more than 4 km of lanes.
    """
    length = lane_arc_lengths(scene)
    spacing *= max(1.0, length.sum() / LONGEST)
    count = np.maximum(1, np.round(length / spacing)).astype(int)
    first = np.cumsum(count) - count
    middle = np.arange(count.sum()) - np.repeat(first, count) + 0.5
    arc = np.repeat(np.cumsum(length) - length, count) + middle * np.repeat(length / count, count)
    points, direction = points_along(lane_segments(scene), arc)
    return np.concatenate([points[:, :2], DIRECTION * direction], 1)


def lane_distance(first: Scene, second: Scene) -> float:
    """Symmetric mean Chamfer distance between the lanes of two single scenes, direction included [m].

    With rho(p, q) = sqrt(|xy_p - xy_q|^2 + (2 m)^2 |u_p - u_q|^2) over ``lane_points`` (u: unit direction), each side
    is
    the mean of rho to the nearest point of the other scene; the result is the mean of both sides. 0 for equal lanes in
    any order; inf if only one scene has lanes. Both scenes stay in their ego frame.
    """
    return _chamfer(*(_tree(lane_points(scene)) for scene in (first, second)))


def nearest_tiles(scenes: Scene | Iterable[Scene], bank: Scene | Iterable[Scene]) -> Iterator[tuple[Nearest, Nearest]]:
    """The nearest tile of ``bank`` for each scene: once in the ego frames, once after alignment.

    Training shifts and turns its tiles a little, so a copy may be moved against its tile. The second result therefore
    lets the scene move by up to 4 m and 15 degrees (``alignment.register``), also for the match.

    The first pass compares points at 6 m spacing with every tile (also with the scene turned by +-8 degrees). The
    second pass compares the best 5 % (at least 200) at 2 m. The scene is aligned with the best 64.

    Raises:
      ValueError: the bank is empty.
    """
    tiles = list(singles(bank))
    if not tiles:
        raise ValueError("there are no training tiles to compare with: the bank is empty")
    coarse, fine = ([lane_points(tile, spacing) for tile in tiles] for spacing in (_COARSE, SPACING))
    stack = _Stack(coarse)
    keep = max(_SHORTLIST_LEAST, math.ceil(_SHORTLIST_SHARE * len(tiles)))
    everything = list(range(len(tiles)))
    for scene in singles(scenes):
        points, few = lane_points(scene), lane_points(scene, _COARSE)
        turned = np.stack([stack.distances(transform_points(few, _turn(yaw))) for yaw in _TURNS])
        shortlist = _best(everything, turned[0], keep)
        finalists = _best(shortlist, _Stack([fine[tile] for tile in shortlist]).distances(points), _FINALISTS)
        plain = _nearest(scene, points, tiles, dict.fromkeys(finalists, _turn(0.0)))
        poses = {
            tile: register(few, coarse[tile], _turn(_TURNS[int(turned[:, tile].argmin())]), 5)
            for tile in _best(everything, turned.min(0), _ALIGNED)
            if len(few) and len(coarse[tile])
        }
        gaps = [_Stack([coarse[tile]]).distances(transform_points(few, pose))[0] for tile, pose in poses.items()]
        closest = _best(list(poses), np.array(gaps), _FINALISTS)
        refined = {tile: register(points, fine[tile], poses[tile], 5) for tile in closest}
        yield plain, min(plain, _nearest(scene, points, tiles, refined), key=lambda near: near.lane_distance)


def _nearest(scene: Scene, points: np.ndarray, tiles: Sequence[Scene], poses: dict[int, Pose]) -> Nearest:
    """The nearest of the tiles in ``poses`` by exact distance, with the scene moved by each pose."""
    best = Nearest(tile=-1, lane_distance=math.inf, match={}, pose=_turn(0.0))
    for tile, pose in poses.items():
        distance = _chamfer(_tree(transform_points(points, pose)), _tree(lane_points(tiles[tile])))
        if distance < best.lane_distance or best.tile < 0:
            best = Nearest(tile=tile, lane_distance=distance, match={}, pose=pose)
    if best.tile < 0:
        return best
    agents = np.array(scene.agents)
    agents[:, :2] = transform_points(agents[:, :2], best.pose)
    return dataclasses.replace(best, match=match(tiles[best.tile], scene.replace(agents=agents)))


def _turn(yaw: float) -> Pose:
    return np.array([0.0, 0.0, yaw])


def _best(candidates: Sequence[int], distances: np.ndarray, count: int) -> list[int]:
    """The ``count`` nearest candidates, in the order of the bank."""
    return sorted(candidates[index] for index in np.argsort(distances, kind="stable")[:count])


def _tree(points: np.ndarray) -> KDTree | None:
    return KDTree(points) if len(points) else None


def _chamfer(first: KDTree | None, second: KDTree | None) -> float:
    if first is None or second is None:
        return 0.0 if first is second else math.inf
    there, back = np.asarray(second.query(first.data)[0]), np.asarray(first.query(second.data)[0])
    return float((there.mean() + back.mean()) / 2)


class _Stack:
    """Points of many tiles in a few matrices: distances of a scene to all tiles take a few large operations.

    |p - q|^2 is one matrix product, [p, |p|^2, 1] . [-2 q, 1, |q|^2], in float32 (error about 0.02 m). Tiles with
    similar numbers of points share a matrix, padded with points at infinity.
    """

    def __init__(self, clouds: Sequence[np.ndarray], group: int = 64):
        self._total = len(clouds)
        order = sorted(range(len(clouds)), key=lambda tile: len(clouds[tile]))
        self._groups = []
        for start in range(0, len(order), group):
            tiles = order[start : start + group]
            count = np.array([len(clouds[tile]) for tile in tiles])
            left = np.zeros((len(tiles), max(count.max(), 1), 6), np.float32)
            left[..., 4] = _FAR
            for row, tile in enumerate(tiles):
                points = clouds[tile]
                left[row, : len(points), :4] = points
                left[row, : len(points), 4] = (points**2).sum(-1)
                left[row, : len(points), 5] = 1
            self._groups.append((np.array(tiles), count, left))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """``lane_distance`` of ``points`` to every tile [m]."""
        result = np.full(self._total, np.inf)
        square = (points**2).sum(-1, keepdims=True)
        right = np.concatenate([-2 * points, np.ones_like(square), square], 1).astype(np.float32).T
        for tiles, count, left in self._groups:
            if not len(points):
                result[tiles[count == 0]] = 0.0
                continue
            there, nearest = [], np.full(left.shape[:2], _FAR)
            step = max(1, _UNTHREADED // left[0].size)
            for start in range(0, len(points), step):
                squared = left @ right[:, start : start + step]  # [tiles, their points, points]
                there.append(squared.min(1))
                nearest = np.minimum(nearest, squared.min(2))
            there = np.sqrt(np.maximum(np.concatenate(there, 1), 0.0)).mean(1)
            nearest = np.sqrt(np.maximum(nearest, 0.0))
            nearest[left[..., 4] == _FAR] = 0.0
            back = nearest.sum(1) / np.maximum(count, 1)
            result[tiles] = np.where(count > 0, (there + back) / 2, np.inf)
        return result
