"""Which vehicles of a simulation become egos: apart from each other, and away from boxes that overlap."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from scjax.scene import AgentType
from scjax.towns.town_traffic import TownTraffic

STEPS_BACK, STEPS_AHEAD = 20, 80  # of a log around its moment: 2 s and 8 s
_STEPS_BETWEEN = 100  # moments of a simulation at which egos are chosen
_CHECK_EVERY = 5  # steps
_APART = 60.0  # m between egos of one moment
_SIGHT = 95.0  # m around an ego where no boxes may overlap
_LEAST_EGO_LENGTH = 3.0  # m
_ALLOWED_DEPTH = 0.02  # m


def choose_egos(traffic: TownTraffic, most: int, seed: int) -> Int[np.ndarray, "egos 2"]:
    """Pairs (step, object), ``most`` for each moment at most."""
    rng = np.random.default_rng([seed, 11])
    vehicles = (traffic.types == AgentType.VEHICLE) & (traffic.sizes[:, 0] > _LEAST_EGO_LENGTH)
    chosen: list[tuple[int, int]] = []
    for step in range(STEPS_BACK, traffic.num_steps - STEPS_AHEAD, _STEPS_BETWEEN):
        first, last = step - STEPS_BACK, step + STEPS_AHEAD
        candidates = np.flatnonzero(vehicles & (traffic.starts <= first) & (traffic.ends > last))
        faults = [overlapping_places(traffic, k) for k in range(first, last + 1, _CHECK_EVERY)]
        places = np.zeros((0, 2))
        for ego in map(int, rng.permutation(candidates)):
            if len(places) >= most:
                break
            place = _place(traffic, ego, step)
            if len(places) and np.hypot(*(places - place).T).min() < _APART:
                continue
            if any(
                len(fault) and np.hypot(*(fault - _place(traffic, ego, k)).T).min() < _SIGHT
                for fault, k in zip(faults, range(first, last + 1, _CHECK_EVERY), strict=True)
            ):
                continue
            places = np.concatenate([places, place[None]])
            chosen.append((step, ego))
    return np.array(chosen, np.int64).reshape(-1, 2)


def _place(traffic: TownTraffic, item: int, step: int) -> np.ndarray:
    return traffic.positions[traffic.offsets[item] + step - traffic.starts[item], :2]


def overlapping_places(traffic: TownTraffic, step: int) -> np.ndarray:
    """Centers [boxes, 2] of the boxes that overlap another one at a step [m]; of two people neither counts."""
    from scipy.spatial import KDTree

    objects = traffic.objects_between(step, step + 1)
    rows = traffic.rows_at(objects, step)
    if len(objects) < 2:
        return np.zeros((0, 2))
    xyz, headings, sizes = traffic.positions[rows], traffic.headings[rows], traffic.sizes[objects]
    i, j = KDTree(xyz[:, :2]).query_pairs(20.0, output_type="ndarray").reshape(-1, 2).T
    people = traffic.types[objects] == AgentType.PEDESTRIAN
    near = ~(people[i] & people[j]) & (np.abs(xyz[i, 2] - xyz[j, 2]) < (sizes[i, 2] + sizes[j, 2]) / 2)
    i, j = i[near], j[near]
    deep = box_depth(xyz[:, :2], headings, sizes, i, j) > _ALLOWED_DEPTH
    return xyz[np.unique(np.concatenate([i[deep], j[deep]])), :2]


def box_depth(xy: np.ndarray, headings: np.ndarray, sizes: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Least shift that would part boxes i and j [pairs], negative where they are apart [m]."""
    axes = np.stack([np.cos(headings), np.sin(headings)], -1)
    axes = np.stack([axes, np.stack([-axes[:, 1], axes[:, 0]], -1)], 1)  # [boxes, 2 axes, xy]
    offset = xy[j] - xy[i]
    depth = np.full(len(i), np.inf)
    for a, b in ((i, j), (j, i)):
        distance = np.abs(np.einsum("px,pkx->pk", offset, axes[a]))
        cosines = np.abs(np.einsum("pkx,plx->pkl", axes[a], axes[b]))
        reach = sizes[a, :2] / 2 + np.einsum("pkl,pl->pk", cosines, sizes[b, :2] / 2)
        depth = np.minimum(depth, (reach - distance).min(-1))
    return depth
