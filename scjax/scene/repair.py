"""Repairs of generated scenes: leaves out dead turns, smooths lanes, closes connections, separates boxes.

A diffusion model gives every point and box an error of its own: lanes tremble, linked lanes do not meet exactly, and
boxes in a queue overlap. Map formats and simulators need better. ``scjax.sample`` does not repair, and no metric is
taken after a repair unless its row says so.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import Link, Scene, stack
from scjax.scene.boxes import overlaps
from scjax.scene.loose_ends import remove_dead_turns

MAX_CONNECTION_GAP = 5.0  # m; links over wider gaps are removed
_SHIFTS = np.array([0.5, -0.5, 1, -1, 1.5, -1.5, 2, -2, 3, -3, 4, -4, 6, -6])  # m along the heading of a box
_CLEARANCE = 0.1  # m between boxes that were separated
_STIFFNESS = 4.0  # of a lane against a change of curvature; real lanes move by 1 cm in the mean
_MIN_ROUGHNESS = 0.02  # m; lanes that smoothing would move by less stay as they are


def repair(scene: Scene, *, known_agents: int = 0, known_lanes: int = 0) -> Scene:
    """Applies ``remove_dead_turns``, ``smooth_lanes``, ``close_connections`` and ``separate_boxes``.

    Turns are left out only in scenes without known lanes, since a known one may be what a turn leads to.

    Args:
      scene: one scene or a batch.
      known_agents, known_lanes: so many leading elements, those given to the model, stay as they are.
    """
    if scene.batch_shape:
        singles = [scene[i] for i in range(scene.batch_shape[0])]
        return stack([repair(single, known_agents=known_agents, known_lanes=known_lanes) for single in singles])
    scene = scene if known_lanes else remove_dead_turns(scene)
    scene = close_connections(smooth_lanes(scene, known=known_lanes), known=known_lanes)
    return separate_boxes(scene, known=known_agents)


def smooth_lanes(scene: Scene, *, known: int = 0) -> Scene:
    """Smooths lanes whose points tremble: least squares with a penalty on third differences (Whittaker 1923).

    Straight lanes and bends of even curvature stay as they are.

    Args:
      scene: one scene.
      known: so many leading lanes stay as they are.
    """
    scene = scene.to_numpy()
    lanes = np.array(scene.lanes)
    third = np.diff(np.eye(lanes.shape[1]), 3, axis=0)
    smoother = np.linalg.inv(np.eye(lanes.shape[1]) + _STIFFNESS * third.T @ third)
    smooth = np.einsum("pq,lqd->lpd", smoother, lanes.astype(np.float64))
    roughness = np.sqrt(np.square(smooth - lanes)[..., :2].sum(-1).mean(-1))
    for i in np.flatnonzero(np.asarray(scene.lane_mask) & (roughness > _MIN_ROUGHNESS)):
        if i >= known:
            lanes[i] = _equally_spaced(smooth[i])
    return scene.replace(lanes=lanes)


def close_connections(scene: Scene, *, max_gap: float = MAX_CONNECTION_GAP, known: int = 0) -> Scene:
    """Moves lane ends so that every lane ends exactly where its successors start.

    All ends that links connect move to their mean, or to the mean of the known ones among them. The rest of a lane
    follows in proportion, and its points are spaced equally again. Two kinds of links are removed: those over a gap
    wider than ``max_gap``, and the widest of those that would bring both ends of a lane to one place.

    Args:
      scene: one scene.
      max_gap: [m].
      known: so many leading lanes do not move, and links between them stay.
    """
    scene = scene.to_numpy()
    lanes, links = np.array(scene.lanes, np.float64), np.array(scene.links)
    valid = np.asarray(scene.lane_mask)
    pairs = np.argwhere((links == Link.PREDECESSOR) & valid[:, None] & valid[None, :])
    gaps = np.linalg.norm(lanes[pairs[:, 0], -1, :2] - lanes[pairs[:, 1], 0, :2], axis=-1)
    group, rejected = _group_ends(len(lanes), pairs, gaps, max_gap)
    removed = pairs[rejected & (pairs >= known).any(-1)]
    links[removed[:, 0], removed[:, 1]] = links[removed[:, 1], removed[:, 0]] = Link.NONE
    moves = _end_moves(lanes, group, known)
    share = np.linspace(0, 1, lanes.shape[1])[:, None]
    connected = np.array(scene.lanes)
    for i in np.flatnonzero(np.abs(moves).sum((1, 2))):
        connected[i] = _equally_spaced(lanes[i] + (1 - share) * moves[i, :1] + share * moves[i, 1:])
    return scene.replace(lanes=connected, links=links)


def separate_boxes(scene: Scene, *, known: int = 0) -> Scene:
    """Moves overlapping boxes along their heading, by the smallest of some distances up to 6 m that frees them.

    Of two boxes the one nearer to the ego stays. A box that no shift frees stays too: no agent is removed.

    Args:
      scene: one scene.
      known: so many leading agents, and always the ego, do not move.
    """
    scene = scene.to_numpy()
    agents = np.array(scene.agents, np.float64)
    num_fixed, rows = max(known, 1), np.flatnonzero(scene.agent_mask)
    distance = np.where(rows < num_fixed, -1.0, np.linalg.norm(agents[rows, :2], axis=-1))
    rows = rows[np.argsort(distance, kind="stable")]
    moved = []
    for rank, i in enumerate(rows):
        others = agents[rows[:rank]]
        if i < num_fixed or _is_free(agents[i], others):
            continue
        shifts = np.zeros((len(_SHIFTS), agents.shape[1]))
        shifts[:, :2] = _SHIFTS[:, None] * agents[i, 4:6]
        for candidate in agents[i] + shifts:
            if _is_free(candidate, others, _CLEARANCE):
                agents[i] = candidate
                moved.append(i)
                break
    states = np.array(scene.agents)
    states[moved] = agents[moved]
    return scene.replace(agents=states)


def _group_ends(
    count: int, pairs: Int[np.ndarray, "connections 2"], gaps: Float64[np.ndarray, " connections"], max_gap: float
) -> tuple[Int[np.ndarray, " ends"], Bool[np.ndarray, " connections"]]:
    """Group of each lane end (starts of all lanes, then ends) that meets in one point, and the rejected connections.

    Narrow connections are closed first. One is rejected if it is wider than ``max_gap`` or both ends of a lane would
    meet.
    """
    groups = [{end} for end in range(2 * count)]
    rejected = gaps > max_gap
    for row in np.argsort(gaps, kind="stable"):
        first, second = groups[pairs[row, 0] + count], groups[pairs[row, 1]]
        if rejected[row] or first is second:
            continue
        union = first | second
        if len({end % count for end in union}) < len(union):
            rejected[row] = True
            continue
        for end in union:
            groups[end] = union
    return np.array([min(ends) for ends in groups], int), rejected


def _end_moves(
    lanes: Float64[np.ndarray, "lanes points 3"], group: Int[np.ndarray, " ends"], known: int
) -> Float64[np.ndarray, "lanes 2 3"]:
    """Vectors by which the start and the end of every lane move to the mean of their group [m]."""
    count = len(lanes)
    ends = np.concatenate([lanes[:, 0], lanes[:, -1]])
    fixed = np.tile(np.arange(count) < known, 2)
    weight = np.where(np.bincount(group, fixed, 2 * count)[group] > 0, fixed, 1.0)
    total = np.maximum(np.bincount(group, weight, 2 * count), 1e-12)
    mean = np.stack([np.bincount(group, weight * column, 2 * count) / total for column in ends.T], -1)[group]
    return np.where(fixed[:, None], 0.0, mean - ends).reshape(2, count, 3).swapaxes(0, 1)


def _equally_spaced(points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=-1))])
    target = np.linspace(0, arc[-1], len(points))
    spaced = np.stack([np.interp(target, arc, column) for column in points.T], -1)
    spaced[0], spaced[-1] = points[0], points[-1]
    return spaced


def _is_free(box: np.ndarray, others: np.ndarray, clearance: float = 0.0) -> Bool[np.ndarray, ""] | bool:
    """Whether a box, grown by ``clearance`` [m] on every side, shares no ground with the others."""
    grown = np.array(box)
    grown[6:8] += 2 * clearance
    near = others[np.linalg.norm(others[:, :2] - box[:2], axis=-1) < 0.5 * (grown[6:8].sum() + others[:, 6:8].sum(-1))]
    return not overlaps(np.concatenate([grown[None], near]))[0].any()
