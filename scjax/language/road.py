"""The lanes of one scene as the captioner sees them: chains merged, finely resampled, with headings and turns."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Link, Scene, Signal, unpadded
from scjax.scene.lane_chains import compact

POINTS = 81
_ENDS = 0.1  # share of a lane over which its direction at an end is taken


def wrapped(angle):
    """Into -pi .. pi [rad]."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


@dataclasses.dataclass(frozen=True)
class Road:
    """Lanes in driving direction, frame of the ego (x forward, y left), metres and radians.

    Attributes:
      line: equally spaced in xy arc length.
      z: NaN where unknown.
      successors, predecessors: of each lane.
      signal: ``Signal`` of each lane; recorded: whether the scene has any.
    """

    line: Float64[np.ndarray, "lanes points 2"]
    z: Float64[np.ndarray, "lanes points"]
    successors: list[list[int]]
    predecessors: list[list[int]]
    signal: Int[np.ndarray, " lanes"]

    def __len__(self) -> int:
        return len(self.line)

    @functools.cached_property
    def chord(self) -> Float64[np.ndarray, "lanes segments"]:
        """Heading of every segment [rad]."""
        step = np.diff(self.line, axis=1)
        return np.arctan2(step[..., 1], step[..., 0])

    @functools.cached_property
    def length(self) -> Float64[np.ndarray, " lanes"]:
        """xy arc length [m]."""
        return np.linalg.norm(np.diff(self.line, axis=1), axis=-1).sum(-1)

    @functools.cached_property
    def bend(self) -> Float64[np.ndarray, "lanes joints"]:
        """Signed turn from each segment to the next [rad], left positive."""
        return wrapped(np.diff(self.chord, axis=1))

    @functools.cached_property
    def turn(self) -> Float64[np.ndarray, " lanes"]:
        """Signed turn over the whole lane [rad]."""
        return self.bend.sum(-1)

    @property
    def end_heading(self) -> Float64[np.ndarray, " lanes"]:
        """Of the last segment [rad]."""
        return self.chord[:, -1]

    @functools.cached_property
    def turn_at_ends(self) -> Float64[np.ndarray, "lanes 2"]:
        """Absolute turn over the first and over the last tenth of each lane [rad]."""
        part = max(1, round(_ENDS * self.bend.shape[1]))
        return np.abs(np.stack([self.bend[:, :part].sum(-1), self.bend[:, -part:].sum(-1)], -1))

    def neighbours(self, lane: int) -> set[int]:
        """Lanes before and after."""
        return {*self.successors[lane], *self.predecessors[lane]}

    def connected(self, lane: int) -> set[int]:
        """Lanes that can be reached from ``lane``, driving either way."""
        found, open_ = {lane}, [lane]
        while open_:
            fresh = self.neighbours(open_.pop()) - found
            found |= fresh
            open_ += fresh
        return found


def road_of(scene: Scene) -> Road:
    """The road of one scene; lanes without any length are left out."""
    scene = unpadded(scene.to_numpy())
    points = np.asarray(scene.lanes, np.float64)
    points[..., 2] = np.where(np.asarray(scene.lane_known)[:, None, 2], points[..., 2], np.nan)
    joins = {(int(i), int(j)) for i, j in np.argwhere(scene.links == Link.PREDECESSOR)}
    chains, edges = compact(len(points), joins)
    lines = [np.concatenate([points[chain[0]], *(points[lane][1:] for lane in chain[1:])]) for chain in chains]
    kept = [row for row, line in enumerate(lines) if np.hypot(*np.diff(line[:, :2], axis=0).T).sum() > 1e-3]
    rows = {row: number for number, row in enumerate(kept)}
    pairs = sorted({(rows[int(i)], rows[int(j)]) for i, j in edges if int(i) in rows and int(j) in rows})
    fine = np.stack([_resampled(lines[row]) for row in kept]) if kept else np.zeros((0, POINTS, 3))
    signals = [scene.signals[list(chains[row])] for row in kept]
    lit = [next((int(s) for s in states if s != Signal.UNKNOWN), int(Signal.UNKNOWN)) for states in signals]
    return Road(
        line=fine[..., :2], z=fine[..., 2],
        successors=[[j for i, j in pairs if i == lane] for lane in range(len(kept))],
        predecessors=[[i for i, j in pairs if j == lane] for lane in range(len(kept))],
        signal=np.array(lit, int),
    )  # fmt: skip


def _resampled(line: np.ndarray) -> np.ndarray:
    step = np.hypot(*np.diff(line[:, :2], axis=0).T)
    line = line[np.concatenate([[True], step > 1e-9])]
    arc = np.concatenate([[0], np.cumsum(step[step > 1e-9])])
    at = np.linspace(0, arc[-1], POINTS)
    return np.stack([np.interp(at, arc, line[:, k]) for k in range(3)], -1)
