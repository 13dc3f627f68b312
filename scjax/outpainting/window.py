"""The window of a map that the next tile is generated in: what is known of it, in the window's frame."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from scjax.data.map_crop import crop_map, near_map
from scjax.data.token_order import known_half
from scjax.outpainting.coverage import AHEAD, Coverage, OpenEnd, connected_ends
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.traffic_side import keeps_right
from scjax.scene import TILE_SIZE, AgentType, Crop, Map, MapLane, MapTile, Scene, TileStatus, permute
from scjax.scene.agent_sizes import CLASS_SIZES
from scjax.scene.lane_overlaps import overlap_places
from scjax.scene.polyline import cumulative_length, spread_points

HALF = TILE_SIZE / 2
MAX_KNOWN = (40, 64)
"""Most known agents and lanes; those nearest to the origin are kept."""

_TAIL = 10.0  # m; loose ends of lanes that reach so far beyond the seam are cut off and generated anew
_ON_SEAM = 1e-3  # m beyond the seam that are no tail
_SAME_END = 2.0  # m; lanes whose starts or ends are nearer part or meet
_SHORTEST = 2.0  # m of a lane ahead that count


class WindowPose(NamedTuple):
    """Center of a window and direction of its x axis, in the frame of the map [m, rad]."""

    x: float
    y: float
    z: float
    yaw: float

    def to_map(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
        """Points of the window in the frame of the map."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0)
        return np.stack([cos * x - sin * y + self.x, sin * x + cos * y + self.y, z + self.z], -1)

    def to_window(self, points: Float[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
        """The inverse of ``to_map``."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        x, y, z = np.moveaxis(np.asarray(points, np.float64) - np.array([self.x, self.y, self.z]), -1, 0)
        return np.stack([cos * x + sin * y, cos * y - sin * x, z], -1)


@dataclasses.dataclass(frozen=True)
class KnownWindow:
    """What is known of a window.

    Attributes:
      pose: where it is.
      map: the map, whose lanes no longer reach a little beyond the seam.
      scene: the known elements, unpadded, in the frame of the window.
      open_ends: ends inside the window at which the road must go on, in the frame of the map.
      dead_turns: which lanes of the map can be left out where nothing continues them.
    """

    pose: WindowPose
    map: Map
    scene: Scene
    open_ends: tuple[OpenEnd, ...]
    dead_turns: DeadTurns

    def is_dead(self, place: Float64[np.ndarray, " 2"], outward: float) -> bool:
        """Whether an end of a lane that nothing continues is dead once the tile is there, as ``measure_map`` says."""
        beyond = place + AHEAD * np.array([np.cos(outward), np.sin(outward)])
        return bool(self._covered.contains(beyond[None])[0])

    @functools.cached_property
    def keeps_right(self) -> bool | None:
        """Whether traffic keeps to the right here, or else on the whole map; None if nothing says so."""
        here = keeps_right([lane.points for lane in self.near.lanes])
        return keeps_right([lane.points for lane in self.map.lanes]) if here is None else here

    def brings_overlap(self, lines: Sequence[Float64[np.ndarray, "_ 3"]]) -> bool:
        """Whether there are more places where lanes lie on each other with these new lanes than without them."""
        known = [lane.points for lane in self.near.lanes]
        return len(overlap_places([*lines, *known], _SAME_END)) > len(overlap_places(known, _SAME_END))

    @functools.cached_property
    def near(self) -> Map:
        """The map with only the lanes in and around the window."""
        return near_map(self.map, self.pose.x, self.pose.y, HALF * 1.5)

    @functools.cached_property
    def _covered(self) -> Coverage:
        x, y, z, yaw = self.pose
        tile = MapTile(x=x, y=y, z=z, yaw=yaw, status=TileStatus.COMPLETE)
        return Coverage(dataclasses.replace(self.map, tiles=(*self.map.tiles, tile)))


def cut_window(map: Map, pose: WindowPose, *, speed: float = 8.0, ego: bool = True, domain: int = 0) -> Scene:
    """The known elements of the window of ``map`` at ``pose``, at most ``MAX_KNOWN``.

    The crop is partitioned if nothing is known ahead of the seam, else centered.

    Args:
      speed: of the vehicle at the origin [m/s], which the network needs as ego.
      ego: whether there is such a vehicle; without it agent 0 is the nearest agent.

    Raises:
      ValueError: no lane for cars is in the window.
    """
    is_open = not _reaches_ahead(map, pose)
    crop = Crop.PARTITIONED if is_open else Crop.CENTERED
    scene = crop_map(map, pose.x, pose.y, pose.yaw, crop=crop, ego=ego, domain=domain)
    if ego:
        agents = np.array(scene.agents)
        agents[0, 3], agents[0, 6:] = speed, CLASS_SIZES[AgentType.VEHICLE]
        scene = scene.replace(agents=agents)
    behind = np.asarray(scene.agents)[:, 0] <= 0 if is_open else np.ones(len(scene.agents), bool)
    behind[:1] |= ego
    lanes = np.arange(min(len(scene.lane_mask), MAX_KNOWN[1]))
    if is_open:
        lanes = lanes[known_half(np.asarray(scene.lanes)[lanes, :, :2], np.zeros((0, 2))).lanes]
    return permute(scene, np.flatnonzero(behind)[: MAX_KNOWN[0]], lanes)


def trim_tails(map: Map, pose: WindowPose) -> Map:
    """``map`` without the parts of lanes that reach a little beyond the seam of a window and end there."""
    near = {lane.id for lane in near_map(map, pose.x, pose.y).lanes}
    starts, ends = connected_ends(map)
    lanes = []
    for lane in map.lanes:
        if lane.id in near:
            if lane.id not in ends:
                lane = dataclasses.replace(lane, points=_without_tail(lane.points, pose))
            if lane.id not in starts:
                lane = dataclasses.replace(lane, points=_without_tail(lane.points[::-1], pose)[::-1])
        lanes.append(lane)
    return dataclasses.replace(map, lanes=tuple(lanes))


def _without_tail(points: Float64[np.ndarray, "points 3"], pose: WindowPose) -> Float64[np.ndarray, "n 3"]:
    """A line whose last part beyond x = 0 is cut off, if that part is short and begins in the window."""
    x, y, _ = pose.to_window(points).T
    behind = np.flatnonzero(x <= 0)
    if x[-1] <= _ON_SEAM or not len(behind) or abs(y[behind[-1]]) > HALF:
        return points
    last = behind[-1]
    share = -x[last] / (x[last + 1] - x[last])
    cut = points[last] + share * (points[last + 1] - points[last])
    tail = np.concatenate([cut[None], points[last + 1 :]])
    if cumulative_length(tail)[-1] > _TAIL:
        return points
    kept = np.concatenate([points[: last + 1], cut[None]])
    return kept if cumulative_length(kept)[-1] > 0.5 else points


def _reaches_ahead(map: Map, pose: WindowPose) -> bool:
    """Whether a lane of the map runs in the front half of a window."""
    return any(_length_ahead(lane, pose) > _SHORTEST for lane in near_map(map, pose.x, pose.y, HALF * 1.5).lanes)


def _length_ahead(lane: MapLane, pose: WindowPose) -> float:
    x, y, _ = pose.to_window(spread_points(lane.points)).T
    return float(((x > 0) & (x < HALF) & (np.abs(y) < HALF)).sum())
