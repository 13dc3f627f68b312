"""Small repairs of generated scenes: wavy lanes smoothed, open joints closed, overlapping boxes moved apart.

A diffusion model draws every point and every box with an error of its own, so that lanes tremble, linked lanes do not
meet exactly and boxes in a queue touch. Map formats and simulators want better. Nothing of this runs inside
``scjax.sample``, and no metric is taken after it unless its row says so.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import Link, Scene, stack
from scjax.scene.boxes import overlaps

REACH = 5.0  # m, a joint wider than that is no joint
_SLIDES = np.array([0.5, -0.5, 1, -1, 1.5, -1.5, 2, -2, 3, -3, 4, -4, 6, -6])  # m along a box's own heading
_AIR = 0.1  # m between boxes that were moved apart
_STIFFNESS = 4.0  # of a lane against a change of curvature; real lanes move by 1 cm in the mean
_TREMOR = 0.02  # m; lanes that smoothing would move by less are left alone


def repair(scene: Scene, *, known_agents: int = 0, known_lanes: int = 0) -> Scene:
    """``smooth_lanes``, ``join_lanes``, ``separate``; elements given to the model (they come first) stay as they are.

    Args:
      scene: one scene or a batch.
    """
    if scene.batch_shape:
        return stack([
            repair(scene[i], known_agents=known_agents, known_lanes=known_lanes) for i in range(scene.batch_shape[0])
        ])  # fmt: skip
    return separate(join_lanes(smooth_lanes(scene, known=known_lanes), known=known_lanes), known=known_agents)


def smooth_lanes(scene: Scene, *, known: int = 0) -> Scene:
    """Lanes whose points tremble are smoothed: least squares with a penalty on third differences (Whittaker 1923).

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
    tremor = np.sqrt(np.square(smooth - lanes)[..., :2].sum(-1).mean(-1))
    for i in np.flatnonzero(np.asarray(scene.lane_mask) & (tremor > _TREMOR)):
        if i >= known:
            lanes[i] = _equally_spaced(smooth[i])
    return scene.replace(lanes=lanes)


def join_lanes(scene: Scene, *, reach: float = REACH, known: int = 0) -> Scene:
    """Every lane that leads into another one ends exactly where that one starts.

    All ends that links tie together move to their mean (or to the mean of the known ones among them); the rest of a
    lane follows in proportion, and its points are spaced equally again. Links over a gap wider than ``reach`` [m] go,
    and of those that together would bring both ends of a lane to one place the widest.

    Args:
      scene: one scene.
      known: so many leading lanes do not move, and links between them stay.
    """
    scene = scene.to_numpy()
    lanes, links = np.array(scene.lanes, np.float64), np.array(scene.links)
    valid = np.asarray(scene.lane_mask)
    pairs = np.argwhere((links == Link.PREDECESSOR) & valid[:, None] & valid[None, :])
    gaps = np.linalg.norm(lanes[pairs[:, 0], -1, :2] - lanes[pairs[:, 1], 0, :2], axis=-1)
    group, refused = _places(len(lanes), pairs, gaps, reach)
    false = pairs[refused & (pairs >= known).any(-1)]
    links[false[:, 0], false[:, 1]] = links[false[:, 1], false[:, 0]] = Link.NONE
    moves = _moves(lanes, group, known)
    share = np.linspace(0, 1, lanes.shape[1])[:, None]
    joined = np.array(scene.lanes)
    for i in np.flatnonzero(np.abs(moves).sum((1, 2))):
        joined[i] = _equally_spaced(lanes[i] + (1 - share) * moves[i, :1] + share * moves[i, 1:])
    return scene.replace(lanes=joined, links=links)


def separate(scene: Scene, *, known: int = 0) -> Scene:
    """Boxes that overlap slide along their heading, by the least of some distances up to 6 m that frees them.

    Agents nearer to the ego stand firm. A box that no slide frees stays: nobody is removed, so that counts hold.

    Args:
      scene: one scene.
      known: so many leading agents, and always the ego, do not move.
    """
    scene = scene.to_numpy()
    agents = np.array(scene.agents, np.float64)
    firm, rows = max(known, 1), np.flatnonzero(scene.agent_mask)
    distance = np.where(rows < firm, -1.0, np.linalg.norm(agents[rows, :2], axis=-1))
    rows = rows[np.argsort(distance, kind="stable")]
    moved = []
    for place, i in enumerate(rows):
        others = agents[rows[:place]]
        if i < firm or _free(agents[i], others):
            continue
        ahead = np.zeros((len(_SLIDES), agents.shape[1]))
        ahead[:, :2] = _SLIDES[:, None] * agents[i, 4:6]
        for candidate in agents[i] + ahead:
            if _free(candidate, others, _AIR):
                agents[i] = candidate
                moved.append(i)
                break
    states = np.array(scene.agents)
    states[moved] = agents[moved]
    return scene.replace(agents=states)


def _places(
    count: int, pairs: Int[np.ndarray, "joints 2"], gaps: Float64[np.ndarray, " joints"], reach: float
) -> tuple[Int[np.ndarray, " ends"], Bool[np.ndarray, " joints"]]:
    """Numbers of the places that the ends (starts of all lanes, then ends) belong to, and which joints are refused.

    Narrow joints are closed first; one is refused if it is wider than ``reach`` or leaves nothing of a lane.
    """
    place = [{end} for end in range(2 * count)]  # of each end: all ends that are one with it
    refused = gaps > reach
    for joint in np.argsort(gaps, kind="stable"):
        one, other = place[pairs[joint, 0] + count], place[pairs[joint, 1]]
        if refused[joint] or one is other:
            continue
        together = one | other
        if len({end % count for end in together}) < len(together):
            refused[joint] = True
            continue
        for end in together:
            place[end] = together
    return np.array([min(ends) for ends in place], int), refused


def _moves(
    lanes: Float64[np.ndarray, "lanes points 3"], group: Int[np.ndarray, " ends"], known: int
) -> Float64[np.ndarray, "lanes 2 3"]:
    """How far the start and the end of every lane move to meet those of their group."""
    count = len(lanes)
    ends = np.concatenate([lanes[:, 0], lanes[:, -1]])
    firm = np.tile(np.arange(count) < known, 2)
    weight = np.where(np.bincount(group, firm, 2 * count)[group] > 0, firm, 1.0)
    total = np.maximum(np.bincount(group, weight, 2 * count), 1e-12)
    middle = np.stack([np.bincount(group, weight * column, 2 * count) / total for column in ends.T], -1)[group]
    return np.where(firm[:, None], 0.0, middle - ends).reshape(2, count, 3).swapaxes(0, 1)


def _equally_spaced(points: Float64[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=-1))])
    wanted = np.linspace(0, arc[-1], len(points))
    spaced = np.stack([np.interp(wanted, arc, column) for column in points.T], -1)
    spaced[0], spaced[-1] = points[0], points[-1]
    return spaced


def _free(box: np.ndarray, others: np.ndarray, air: float = 0.0) -> Bool[np.ndarray, ""] | bool:
    """Whether a box, grown by ``air`` [m] on every side, shares no ground with the others."""
    grown = np.array(box)
    grown[6:8] += 2 * air
    near = others[np.linalg.norm(others[:, :2] - box[:2], axis=-1) < 0.5 * (grown[6:8].sum() + others[:, 6:8].sum(-1))]
    return not overlaps(np.concatenate([grown[None], near]))[0].any()
