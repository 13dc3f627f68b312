"""Lanes that the vision network of the package sees in a picture, and scenes that are moved onto them.

Fine cells of the road say where the middle of a lane is and which way it goes. The network that draws scenes knows this
less well. So the ground of a scene is shifted a little, most at the middle of the window and least at its borders:
lanes keep their joints, and agents stay on their lanes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64

from scjax.encoders.dashcam_network import PLACE_SCALE, cells_of_tokens, sureness
from scjax.metrics.lanes import lane_segments
from scjax.scene import Scene

_LEAST = 0.5  # how sure a cell must be that there is a lane
_REACH = (2.0, 45.0)  # m ahead
_SPACING, _TURN = 1.0, 0.5  # m and rad between points that are kept
FEWEST = 8
"""Points of lanes that say anything."""
_SAME_HEADING = np.cos(np.deg2rad(30.0))
_ERROR, _ERROR_SHARE = 0.8, 0.04  # m, and share of the distance: how far a point may be off
_FAR = 8.0  # m; points that are farther from all lanes of their heading are left out
_STARTS = (0.0, -4.0, 4.0)  # m, first guesses of the shift ahead
_ROUNDS = 6
_MOST = np.array([6.0, 2.5, 5.0, 4.0])  # m; the shift ahead, and that to the left: everywhere, at 40 m, of its bend
_LENGTH = 40.0  # m, at which the last two are measured
_WEIGHTS = 0.02  # of squares of shares of ``_MOST``, beside the mean cost of a point, 0 to 1
_GAIN = 0.02  # of that cost, at least
_RAMP_AHEAD, _RAMP_ASIDE = 16.0, 8.0  # m from the borders, where shifts end
_WINDOW = (64.0, 32.0)  # m ahead and to each side


class SeenLanes(NamedTuple):
    """Points of the middles of lanes in the frame of the ego.

    Attributes:
      points: x ahead, y to the left [m].
      headings: unit vectors.
    """

    points: Float64[np.ndarray, "n 2"]
    headings: Float64[np.ndarray, "n 2"]


def seen_lanes(tokens: Float[np.ndarray, "cells width"]) -> SeenLanes:
    """The lanes that tokens of ``encoders.dashcam_network`` say, one point in each square meter and direction.

    Args:
      tokens: of all cells of a picture; their order does not matter.
    """
    lanes = cells_of_tokens(np.asarray(tokens, np.float64))["lane"]
    sure = sureness(lanes[:, -1])
    points = PLACE_SCALE * lanes[:, :2]
    headings = lanes[:, 2:4] / np.maximum(np.linalg.norm(lanes[:, 2:4], axis=1, keepdims=True), 1e-6)
    chosen = (sure > _LEAST) & (points[:, 0] > _REACH[0]) & (np.hypot(*points.T) < _REACH[1])
    points, headings = points[chosen], headings[chosen]
    angles = np.arctan2(headings[:, 1], headings[:, 0])
    squares = np.round(np.column_stack([points / _SPACING, angles / _TURN]))
    rows = np.unique(squares, axis=0, return_index=True)[1]
    return SeenLanes(points[rows], headings[rows])


def shift_to_seen(scene: Scene, first: int, seen: SeenLanes) -> Scene:
    """The scene with its lanes shifted onto those that are seen, and the agents with them.

    Args:
      scene: single, unpadded, in the forward window.
      first: number of the agents that stay: the ego and those that are seen.
    """
    if len(seen.points) < FEWEST or not len(scene.lanes):
        return scene
    segments = lane_segments(scene)
    costs = [(_cost(seen, segments, np.zeros(4)), np.zeros(4))]
    for start in _STARTS:
        shift = np.array([start, 0.0, 0.0, 0.0])
        for _ in range(_ROUNDS):
            shift = _step(seen, segments, shift)
        costs.append((_cost(seen, segments, shift) + _GAIN, shift))
    _, shift = min(costs, key=lambda pair: pair[0])
    if not shift.any():
        return scene
    lanes, agents = np.asarray(scene.lanes, np.float64).copy(), np.asarray(scene.agents, np.float64).copy()
    lanes[..., :2] += _displacements(lanes[..., :2], shift)
    places, headings = agents[first:, :2], agents[first:, 4:6]
    ahead = places + headings + _displacements(places + headings, shift)
    agents[first:, :2] = places + _displacements(places, shift)
    turned = ahead - agents[first:, :2]
    agents[first:, 4:6] = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-6)
    return scene.replace(lanes=lanes.astype(scene.lanes.dtype), agents=agents.astype(scene.agents.dtype))


def _step(seen: SeenLanes, segments: np.ndarray, shift: Float64[np.ndarray, " 4"]) -> Float64[np.ndarray, " 4"]:
    """One round of weighted least squares: across the nearest lanes, and small."""
    foot, across, gaps = _nearest(seen, _shifted(segments, shift))
    near = np.isfinite(gaps) & (gaps < _FAR)
    if not near.any():
        return shift
    foot, across, gaps, errors = foot[near], across[near], gaps[near], lane_errors(seen)[near]
    ratio = gaps / errors
    weights = 1 / (1 + ratio**2) ** 2 / errors**2
    columns = (_basis(foot) * across[:, :, None]).sum(1)
    offsets = ((seen.points[near] - foot) * across).sum(1) + columns @ shift
    gram = (columns * weights[:, None]).T @ columns / len(seen.points) + np.diag(_WEIGHTS / _MOST**2)
    right = (columns * weights[:, None]).T @ offsets / len(seen.points)
    return np.linalg.solve(gram, right).clip(-_MOST, _MOST)


def _cost(seen: SeenLanes, segments: np.ndarray, shift: Float64[np.ndarray, " 4"]) -> float:
    ratio = _nearest(seen, _shifted(segments, shift))[2] / lane_errors(seen)
    return float((1 - 1 / (1 + ratio**2)).mean() + _WEIGHTS * ((shift / _MOST) ** 2).sum())


def lane_errors(seen: SeenLanes) -> Float64[np.ndarray, " n"]:
    """How far each point may be off [m]."""
    return _ERROR + _ERROR_SHARE * np.hypot(*seen.points.T)


def _nearest(seen: SeenLanes, segments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each point the nearest place of a segment of its heading, the direction across it, and the distance [m]."""
    start, along = segments[:, 0, :2], segments[:, 1, :2] - segments[:, 0, :2]
    lengths = np.maximum(np.linalg.norm(along, axis=-1), 1e-6)
    unit = along / lengths[:, None]
    offset = seen.points[:, None] - start
    share = np.clip((offset * unit).sum(-1), 0.0, lengths)
    gaps = np.linalg.norm(offset - share[..., None] * unit, axis=-1)
    gaps = np.where(seen.headings @ unit.T > _SAME_HEADING, gaps, np.inf)
    best, rows = gaps.argmin(1), np.arange(len(gaps))
    across = np.stack([-unit[best, 1], unit[best, 0]], -1)
    return start[best] + share[rows, best, None] * unit[best], across, gaps[rows, best]


def _shifted(segments: np.ndarray, shift: Float64[np.ndarray, " 4"]) -> np.ndarray:
    return segments[..., :2] + _displacements(segments[..., :2], shift)


def _displacements(points: Float64[np.ndarray, "*b 2"], shift: Float64[np.ndarray, " 4"]) -> np.ndarray:
    return _basis(points) @ shift


def _basis(points: Float64[np.ndarray, "*b 2"]) -> Float64[np.ndarray, "*b 2 4"]:
    """x and y of the displacement for each of the four numbers of a shift."""
    x, y = points[..., 0], points[..., 1]
    inside = np.clip((_WINDOW[1] - np.abs(y)) / _RAMP_ASIDE, 0.0, 1.0)
    ahead = np.clip(np.minimum(x, _WINDOW[0] - x) / _RAMP_AHEAD, 0.0, 1.0)
    share = x.clip(0.0, _WINDOW[0]) / _LENGTH
    none = np.zeros_like(x)
    left = np.stack([none, inside, inside * share, inside * (share**2 - share)], -1)
    return np.stack([np.stack([ahead, none, none, none], -1), left], -2)
