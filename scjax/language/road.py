"""The lanes of one scene as the language rules see them: chains merged, finely resampled, with headings and turns."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Link, Scene, Signal, unpadded
from scjax.scene.lane_chains import merge_degree2_chains

POINTS = 81  # per lane
_MIN_LENGTH = 1e-3  # m, shorter lanes are left out
_END_SHARE = 0.1  # of a lane, over which the turn at an end is measured


def wrap_to_pi(angle):
    """Angle in the range -pi .. pi [rad]; numpy counterpart of ``scjax.scene.geometry.wrap_angle``."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@dataclasses.dataclass(frozen=True)
class Road:
    """Lanes in driving direction, in the frame of the ego (x forward, y left) [m, rad].

    Attributes:
      points: centerlines, with points at equal distances along the lane.
      z: heights; NaN where unknown.
      successors, predecessors: indices of the lanes after and before each lane.
      signals: ``Signal`` of each lane.
    """

    points: Float64[np.ndarray, "lanes points 2"]
    z: Float64[np.ndarray, "lanes points"]
    successors: list[list[int]]
    predecessors: list[list[int]]
    signals: Int[np.ndarray, " lanes"]

    def __len__(self) -> int:
        return len(self.points)

    @functools.cached_property
    def headings(self) -> Float64[np.ndarray, "lanes segments"]:
        """Heading of every segment [rad]."""
        step = np.diff(self.points, axis=1)
        return np.arctan2(step[..., 1], step[..., 0])

    @functools.cached_property
    def length(self) -> Float64[np.ndarray, " lanes"]:
        """Length in the plane [m]."""
        return np.linalg.norm(np.diff(self.points, axis=1), axis=-1).sum(-1)

    @functools.cached_property
    def bends(self) -> Float64[np.ndarray, "lanes bends"]:
        """Signed turn from each segment to the next [rad], positive to the left."""
        return wrap_to_pi(np.diff(self.headings, axis=1))

    @functools.cached_property
    def turn(self) -> Float64[np.ndarray, " lanes"]:
        """Signed turn over the whole lane [rad]."""
        return self.bends.sum(-1)

    @property
    def end_heading(self) -> Float64[np.ndarray, " lanes"]:
        """Heading of the last segment [rad]."""
        return self.headings[:, -1]

    @functools.cached_property
    def end_turns(self) -> Float64[np.ndarray, "lanes 2"]:
        """Absolute turn over the first and over the last tenth of each lane [rad]."""
        count = max(1, round(_END_SHARE * self.bends.shape[1]))
        return np.abs(np.stack([self.bends[:, :count].sum(-1), self.bends[:, -count:].sum(-1)], -1))

    def connected_lanes(self, lane: int) -> set[int]:
        """Lanes that can be reached from ``lane`` along successors and predecessors, itself included."""
        connected, frontier = {lane}, [lane]
        while frontier:
            last = frontier.pop()
            new = {*self.successors[last], *self.predecessors[last]} - connected
            connected |= new
            frontier += new
        return connected


def road_from_scene(scene: Scene) -> Road:
    """The road of one scene; lanes without length are left out."""
    scene = unpadded(scene.to_numpy())
    points = np.asarray(scene.lanes, np.float64)
    points[..., 2] = np.where(np.asarray(scene.lane_known)[:, None, 2], points[..., 2], np.nan)
    links = {(int(i), int(j)) for i, j in np.argwhere(scene.links == Link.PREDECESSOR)}
    chains, edges = merge_degree2_chains(len(points), links)
    lines = [np.concatenate([points[chain[0]], *(points[lane][1:] for lane in chain[1:])]) for chain in chains]
    rows = [row for row, line in enumerate(lines) if np.hypot(*np.diff(line[:, :2], axis=0).T).sum() > _MIN_LENGTH]
    lane_of_row = {row: lane for lane, row in enumerate(rows)}
    pairs = sorted(
        {
            (lane_of_row[int(i)], lane_of_row[int(j)])
            for i, j in edges
            if int(i) in lane_of_row and int(j) in lane_of_row
        }
    )
    centerlines = np.stack([_resample(lines[row]) for row in rows]) if rows else np.zeros((0, POINTS, 3))
    return Road(
        points=centerlines[..., :2],
        z=centerlines[..., 2],
        successors=[[j for i, j in pairs if i == lane] for lane in range(len(rows))],
        predecessors=[[i for i, j in pairs if j == lane] for lane in range(len(rows))],
        signals=np.array([_first_signal(np.asarray(scene.signals)[list(chains[row])]) for row in rows], int),
    )


def _first_signal(states: np.ndarray) -> int:
    """The first known ``Signal`` of the lanes of a chain."""
    return next((int(state) for state in states if state != Signal.UNKNOWN), int(Signal.UNKNOWN))


def _resample(line: np.ndarray) -> np.ndarray:
    """``POINTS`` points [x, y, z] at equal distances in the plane."""
    step = np.hypot(*np.diff(line[:, :2], axis=0).T)
    line = line[np.concatenate([[True], step > 1e-9])]
    arc = np.concatenate([[0], np.cumsum(step[step > 1e-9])])
    positions = np.linspace(0, arc[-1], POINTS)
    return np.stack([np.interp(positions, arc, line[:, k]) for k in range(3)], -1)
