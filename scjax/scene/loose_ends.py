"""Lane ends inside the window to which nothing is connected, and turns that lead to nothing but them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene.angles import wrap_to_pi
from scjax.scene.dead_turns import dead_turn
from scjax.scene.polyline import cumulative_length, spread_points
from scjax.scene.scene import TILE_SIZE, AgentType, Crop, Link, Scene, pad, permute

_BORDER = 4.0  # m inside the window, where lanes may end
_MEETS = 0.8  # m between ends that meet without a link
_WAY_BACK = 9.0  # m to where a lane in the other direction begins: a road that ends for good
_OTHER_WAY = np.radians(130.0)  # between headings of two directions
_ON_LANE = 2.0  # m from the middle of a lane
_DRIVERS = (AgentType.VEHICLE, AgentType.CYCLIST)


def loose_ends(scene: Scene) -> list[tuple[int, bool]]:
    """(lane, whether it is its start) of every end inside the window to which nothing is connected.

    Ends that meet without a link, and those of a road where its other direction begins (or ends), do not count. Nor do
    those within 4 m of the border.

    Args:
      scene: one scene.
    """
    scene = scene.to_numpy()
    rows = np.flatnonzero(scene.lane_mask)
    lanes, follows = np.asarray(scene.lanes, np.float64)[rows][..., :2], _follows(scene, rows)
    found = []
    for is_start in (False, True):
        own, other = (lanes[:, 0], lanes[:, -1]) if is_start else (lanes[:, -1], lanes[:, 0])
        is_open, other_open = (~follows.any(0), ~follows.any(1)) if is_start else (~follows.any(1), ~follows.any(0))
        inside = _inside(own, scene)
        headings, other_headings = _headings(lanes, is_start), _headings(lanes, not is_start)
        for i in np.flatnonzero(is_open & inside):
            near = other_open & (np.hypot(*(other - own[i]).T) < _WAY_BACK)
            turned = np.abs(wrap_to_pi(other_headings - headings[i])) > _OTHER_WAY
            if not (near & turned).any():
                found.append((int(rows[i]), is_start))
    return found


def remove_dead_turns(scene: Scene) -> Scene:
    """Leaves out lanes that only lead to a loose end, up to the place where the road has another way, or the border.

    Lanes with the ego, or with a vehicle or cyclist that is on no other lane, stay.

    Args:
      scene: one scene.

    Returns:
      the scene in as many slots; the lanes that stay keep their order.
    """
    scene = scene.to_numpy()
    if not (ends := loose_ends(scene)):
        return scene
    rows = np.flatnonzero(scene.lane_mask)
    follows = _follows(scene, rows)
    after = {int(i): set(rows[follows[row]].tolist()) for row, i in enumerate(rows)}
    before = {int(i): set(rows[follows[:, row]].tolist()) for row, i in enumerate(rows)}
    lines = {int(i): np.asarray(scene.lanes[i], np.float64) for i in rows}
    lengths = {i: float(cumulative_length(line)[-1]) for i, line in lines.items()}
    tips = np.asarray(scene.lanes, np.float64)[rows][:, [0, -1], :2]
    from_border, to_border = (set(rows[~_inside(tips[:, end], scene)].tolist()) for end in (0, 1))
    kept, removed = _driven_lanes(scene, lines), set[int]()
    for lane, is_start in ends:
        ways, border = ((after, before), to_border) if is_start else ((before, after), from_border)
        removed |= dead_turn(lane, *ways, lengths, kept=kept, removed=removed, from_border=border)
    if not removed:
        return scene
    staying = np.delete(np.arange(len(scene.lanes)), list(removed))
    return pad(permute(scene, np.arange(len(scene.agents)), staying), len(scene.agents), len(scene.lanes))


def _inside(points: Float64[np.ndarray, "n 2"], scene: Scene) -> Bool[np.ndarray, " n"]:
    """Which points lie 4 m or more inside the window."""
    center = np.array([TILE_SIZE / 2 if scene.crop == Crop.FORWARD else 0.0, 0.0])
    return np.abs(points - center).max(-1) < TILE_SIZE / 2 - _BORDER


def _follows(scene: Scene, rows: Int[np.ndarray, " n"]) -> Bool[np.ndarray, "n n"]:
    """Which lane (column) follows which (row), by its link or because it begins where that one ends."""
    lanes = np.asarray(scene.lanes, np.float64)[rows][..., :2]
    follows = np.asarray(scene.links)[np.ix_(rows, rows)] == Link.PREDECESSOR
    follows |= np.linalg.norm(lanes[:, None, -1] - lanes[None, :, 0], axis=-1) < _MEETS
    np.fill_diagonal(follows, False)
    return follows


def _headings(lanes: Float64[np.ndarray, "lanes points 2"], at_start: bool) -> Float64[np.ndarray, " lanes"]:
    step = lanes[:, 1] - lanes[:, 0] if at_start else lanes[:, -1] - lanes[:, -2]
    return np.arctan2(step[:, 1], step[:, 0])


def _driven_lanes(scene: Scene, lines: dict[int, np.ndarray]) -> set[int]:
    """Lanes that are the only ones under the ego, a vehicle or a cyclist."""
    drivers = np.asarray(scene.agent_mask) & np.isin(scene.agent_types, _DRIVERS)
    drivers[:1] = scene.agent_mask[:1]
    places = np.asarray(scene.agents, np.float64)[drivers, :2]
    names = list(lines)
    points = [spread_points(lines[i][:, :2]) for i in names]
    gaps = np.array([np.hypot(*(places[:, None] - line[None]).T).min(0) for line in points]).reshape(len(names), -1)
    alone = (gaps < _ON_LANE) & ((gaps < _ON_LANE).sum(0) == 1)
    return {names[row] for row in np.flatnonzero(alone.any(1))}
