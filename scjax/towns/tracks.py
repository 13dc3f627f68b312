"""What SUMO's vehicles did, as motion of boxes on our lanes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from scjax.scene import AgentType
from scjax.scene.polyline import cumulative_length
from scjax.towns.demand import KINDS, PERSON_SIZE
from scjax.towns.lane_paths import LanePath
from scjax.towns.simulation import STEP, Drive

_SMOOTHING = 7  # steps of the mean that evens out speeds where SUMO's lanes are shorter or longer than ours
_BICYCLE_MARGIN = 0.9  # m from the middle of a lane to the right that cyclists keep
_SWAY = 70.0  # m along a lane in which a car sways once
_HALF_CHANGE, _HALF_CHANGE_WAY = 15, 9.0  # steps and m of half a change between lanes, at least
_SWING = 0.6  # share of what a box would cut off a bend, by which its driver swings out
_LEAST_STEPS = 10
_MOST_ACCELERATION = 35.0  # m/s²


@dataclasses.dataclass(frozen=True)
class Track:
    """The motion of one object, at every step of the simulation from ``start`` on.

    Attributes:
      name: of the object.
      agent_type: its type.
      size: length, width, height [m].
      start: first step, counted from the start of the recording.
      positions: centers of the box [m].
      headings: [rad].
    """

    name: str
    agent_type: AgentType
    size: tuple[float, float, float]
    start: int
    positions: Float64[np.ndarray, "steps 3"]
    headings: Float64[np.ndarray, " steps"]

    @property
    def velocities(self) -> Float64[np.ndarray, "steps 2"]:
        """By the positions [m/s]."""
        return np.gradient(self.positions[:, :2], STEP, axis=0)


def drive_track(
    drive: Drive,
    paths: dict[str, LanePath],
    size: tuple[float, float, float],
    begin: float,
    side: float,
    aside: float = 0.0,
) -> list[Track]:
    """The track of a vehicle. It breaks where SUMO's lane lies on none of ours.

    The front of the box runs near the lanes, its rear where the front was: a long box cuts corners a little.

    Args:
      size: length, width, height [m].
      begin: start of the recording [s].
      side: 1 if traffic keeps right, -1 if left.
      aside: mean distance of a car from the middle of its lanes, to the left [m]; it sways by half of that.
    """
    known = np.array([lane in paths for lane in drive.lanes])
    tracks = []
    for part in np.split(np.arange(len(known)), np.flatnonzero(np.diff(known.astype(int))) + 1):
        if len(part) >= _LEAST_STEPS and known[part[0]]:
            tracks += _without_jumps(_track_of(drive, part, paths, size, begin, side, aside))
    return tracks


def _without_jumps(track: Track) -> list[Track]:
    """Parts of a track between steps at which its box jumps, as where SUMO and our lanes disagree."""
    velocities = np.diff(track.positions[:, :2], axis=0) / STEP
    jumps = np.flatnonzero(np.hypot(*np.diff(velocities, axis=0).T) > _MOST_ACCELERATION * STEP) + 1
    parts = []
    for low, high in pairwise([0, *map(int, jumps), len(track.positions)]):
        if low:  # the rear still follows what was before the jump
            way = np.cumsum(np.hypot(*np.diff(track.positions[low:high, :2], axis=0).T))
            low += int(np.searchsorted(way, track.size[0])) + 1
        if high - low >= _LEAST_STEPS:
            parts.append(
                dataclasses.replace(
                    track,
                    name=f"{track.name}+{low}" if low else track.name,
                    start=track.start + low,
                    positions=track.positions[low:high],
                    headings=track.headings[low:high],
                )
            )
    return parts


def _track_of(
    drive: Drive,
    rows: np.ndarray,
    paths: dict[str, LanePath],
    size: tuple[float, float, float],
    begin: float,
    side: float,
    aside: float,
) -> Track:
    kind = KINDS[drive.type.partition(".")[0]]
    lanes = [drive.lanes[row] for row in rows]
    values = drive.values[rows]
    front = front_poses(lanes, values[:, 4], paths)
    offset = aside * (1 + 0.5 * np.sin(2 * np.pi * cumulative_length(front) / _SWAY))
    if kind.agent_type == AgentType.CYCLIST:
        offset = np.full(len(front), -side * _BICYCLE_MARGIN)
    front[:, :2] += offset[:, None] * np.stack([-np.sin(front[:, 3]), np.cos(front[:, 3])], -1)
    behind = _way_behind(paths[lanes[0]], values[0, 4], size[0], front[0])
    line = np.concatenate([behind, front[:, :3]])
    travelled = cumulative_length(line)
    places = _smooth(travelled[len(behind) :])
    center, heading = box_poses(line, travelled, places, size[0])
    center[:, 2] += size[2] / 2
    start = round((values[0, 0] - begin) / STEP)
    return Track(f"{drive.name}@{start}", kind.agent_type, size, start, center, heading)


def front_poses(
    lanes: Sequence[str], positions: Float64[np.ndarray, " steps"], paths: dict[str, LanePath]
) -> Float64[np.ndarray, "steps 4"]:
    """x, y, z [m] and heading [rad] of the front of a vehicle; changes between lanes side by side take 3 s and 18 m.

    Args:
      lanes: SUMO's lane at each step.
      positions: on that lane [m].
    """
    front = np.empty((len(lanes), 4))
    bounds = [0, *(k for k in range(1, len(lanes)) if lanes[k] != lanes[k - 1]), len(lanes)]
    for start, end in pairwise(bounds):
        front[start:end] = paths[lanes[start]].at(positions[start:end])
    edges = [lane.rpartition("_")[0] for lane in lanes]
    along = np.array([a == b for a, b in pairwise(edges)], bool)
    steps = np.where(along, np.abs(np.diff(positions)), np.hypot(*np.diff(front[:, :2], axis=0).T))
    way = np.concatenate([[0.0], np.cumsum(steps)])
    left = np.stack([-np.sin(front[:, 3]), np.cos(front[:, 3])], -1)
    aside = np.zeros(len(lanes))
    for k in bounds[1:-1]:
        if edges[k] == edges[k - 1]:
            old, new = (paths[lanes[row]].at(positions[k : k + 1])[0] for row in (k - 1, k))
            distance = float((new - old)[:2] @ left[k])
            aside += distance * (_change_share(way, k) - (np.arange(len(lanes)) >= k))
    front[:, :2] += aside[:, None] * left
    return front


def _change_share(way: np.ndarray, middle: int) -> np.ndarray:
    """How far a change between lanes is done at each step, 0 to 1; half at step ``middle``.

    It takes 3 s, and 18 m along the lane: a car that creeps does not slide sideways.

    Args:
      way: what was driven until each step [m].
    """
    by_time = (np.arange(len(way)) - middle) / _HALF_CHANGE
    by_way = (way - way[middle]) / _HALF_CHANGE_WAY
    done = np.where(np.abs(by_time) < np.abs(by_way), by_time, by_way)
    share = np.clip((1 + done) / 2, 0.0, 1.0)
    return share**3 * (10 - 15 * share + 6 * share**2)


def box_poses(
    line: Float64[np.ndarray, "points 3"],
    travelled: Float64[np.ndarray, " points"],
    places: Float64[np.ndarray, " steps"],
    length: float,
) -> tuple[Float64[np.ndarray, "steps 3"], Float64[np.ndarray, " steps"]]:
    """Centers [m] and headings [rad] of boxes whose fronts are at ``places`` along a line, and whose rears follow it.

    Ends of long boxes swing out of bends, so that their middle stays near the line.

    Args:
      line: points that the front passes [m].
      travelled: arc length of each [m].
      places: of the front [m]; at least ``length`` from the start of the line.
      length: of the box [m].
    """
    front, middle, rear = (
        np.stack([np.interp(at, travelled, column) for column in line.T], -1)
        for at in (places, places - length / 2, places - length)
    )
    heading = np.unwrap(np.arctan2(front[:, 1] - rear[:, 1], front[:, 0] - rear[:, 0]))
    center = front.copy()
    center[:, 0] -= length / 2 * np.cos(heading)
    center[:, 1] -= length / 2 * np.sin(heading)
    left = np.stack([-np.sin(heading), np.cos(heading)], -1)
    cut = ((middle - center)[:, :2] * left).sum(-1)
    center[:, :2] += _SWING * cut[:, None] * left
    center[:, 2] = (front[:, 2] + rear[:, 2]) / 2
    return center, heading


def _way_behind(path: LanePath, position: float, length: float, first: np.ndarray) -> np.ndarray:
    """Points of the lane behind a place, over the length of a box [m], the farthest first; aside as ``first`` is."""
    place = float(np.interp(position, path.positions, path.places))
    poses = path.at_places(place - np.linspace(length + 1.0, 0.2, 12))
    on_lane = path.at_places(np.array([place]))[0]
    return poses[:, :3] + (first[:3] - on_lane[:3])


def _smooth(places: np.ndarray) -> np.ndarray:
    """Places along a line with evened speeds; ends stay."""
    if len(places) < _SMOOTHING:
        return places
    half = _SMOOTHING // 2
    padded = np.concatenate([2 * places[0] - places[half:0:-1], places, 2 * places[-1] - places[-2 : -half - 2 : -1]])
    smooth = np.convolve(padded, np.full(_SMOOTHING, 1 / _SMOOTHING), "valid")
    return np.clip(np.maximum.accumulate(smooth), places[0], places[-1])


def walk_track(drive: Drive, height_at: Callable[[np.ndarray], np.ndarray], begin: float) -> Track | None:
    """The track of a person.

    Args:
      height_at: function of xy [n, 2] that gives the height of the ground [m].
      begin: start of the recording [s].
    """
    if len(drive.values) < _LEAST_STEPS:
        return None
    xy = drive.values[:, 1:3]
    positions = np.column_stack([xy, height_at(xy) + PERSON_SIZE[2] / 2])
    headings = np.unwrap(np.deg2rad(90.0 - drive.values[:, 3]))
    start = round((drive.values[0, 0] - begin) / STEP)
    return Track(f"{drive.name}@{start}", AgentType.PEDESTRIAN, PERSON_SIZE, start, positions, headings)
