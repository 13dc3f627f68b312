"""Agents matched against a reference scene, and the baseline that only knows the lanes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64

from scjax.metrics.lanes import lane_lengths, places, segments
from scjax.metrics.pooling import Ratios, Values, pool, ratio, singles, values
from scjax.scene import AgentType, Scene

THRESHOLDS = (1.0, 2.0, 3.0)  # metres


Where = Callable[[Float64[np.ndarray, "agents 2"]], Bool[np.ndarray, " agents"]]
"""Which places [m] take part in a comparison."""


def cone(half_angle: float = 50.0, apex: float = 0.0) -> Where:
    """What a camera at (``apex``, 0) that looks ahead may see: within ``half_angle`` degrees of the x axis."""

    def inside(places: Float64[np.ndarray, "agents 2"]) -> Bool[np.ndarray, " agents"]:
        ahead = places[:, 0] - apex
        return (ahead > 0) & (np.abs(np.arctan2(places[:, 1], ahead)) <= np.deg2rad(half_angle))

    return inside


def camera(focal: float, width: float, apex: float = 0.0) -> Where:
    """What a camera that looks ahead has in its picture, by the centres of boxes: ``cone`` of its field of view.

    Args:
      focal, width: focal length and width of the picture [pixels]; heights cut nothing off on a flat road.
      apex: metres ahead of the ego's centre.
    """
    return cone(float(np.rad2deg(np.arctan2(width / 2, focal))), apex)


def match(
    reference: Scene,
    generated: Scene,
    *,
    types: Sequence[AgentType] = tuple(AgentType),
    agnostic: bool = False,
    generated_ego: bool = True,
    where: Where | None = None,
) -> Ratios:
    """Matches of one generated scene with one reference (metrics.md §3, the eval set's ``match``).

    The ego (agent 0) leaves both sides. Generated agents, in stored order, take the nearest reference agent of their
    class that is still free; it is a match where their centres are closer than the threshold in xy.

    Args:
      reference: a single scene.
      generated: a single scene.
      types: classes that take part.
      agnostic: whether agents match across classes.
      generated_ego: False if ``generated`` holds no ego, as scenes of other generators do.
      where: agents elsewhere, of either side, take no part (``cone`` for scenes made from an image).

    Returns:
      "recall_1m" ...: (matches, reference agents); "precision_1m" ...: (matches, generated agents), per threshold.
    """
    (reference,), (generated,) = singles(reference), singles(generated)
    theirs = placed(reference)[taking_part(reference, types, where=where)]
    ours = placed(generated)[taking_part(generated, types, ego=generated_ego, where=where)]
    distance = distances(ours, theirs, agnostic=agnostic)
    ratios: Ratios = {}
    for threshold in THRESHOLDS:
        found = float(hits(distance, threshold).sum())
        ratios[f"recall_{threshold:g}m"] = (found, float(len(theirs)))
        ratios[f"precision_{threshold:g}m"] = (found, float(len(ours)))
    return ratios


def summarise(ratios: Ratios) -> Values:
    """Pooled recalls and precisions; M (match rate: mean recall), P (mean precision) and PxR (mean of the products)."""
    result = values(ratios)
    recalls = np.array([result[f"recall_{threshold:g}m"] for threshold in THRESHOLDS])
    precisions = np.array([result[f"precision_{threshold:g}m"] for threshold in THRESHOLDS])
    means = {"M": recalls.mean(), "P": precisions.mean(), "PxR": (recalls * precisions).mean()}
    return {**{name: float(mean) for name, mean in means.items()}, **result}


def placement(pairs: Iterable[tuple[Scene, Scene]], *, types: Sequence[AgentType] = tuple(AgentType)) -> Values:
    """Values pooled over a stream of (reference, generated) pairs."""
    return summarise(pool(match(reference, generated, types=types) for reference, generated in pairs))


def match_rate(reference: Scene, generated: Scene) -> float:
    """M of one pair of scenes over all classes; NaN where the reference has none but the ego."""
    ratios = match(reference, generated)
    return float(np.mean([ratio(*ratios[f"recall_{threshold:g}m"]) for threshold in THRESHOLDS]))


def vehicle_pool(scenes: Scene | Iterable[Scene]) -> Float64[np.ndarray, "vehicles 4"]:
    """Speed, length, width, height of all vehicles that are not the ego and whose four values are known."""
    found = [np.zeros((0, 4))]
    for scene in singles(scenes):
        use = (scene.agent_types == AgentType.VEHICLE) & scene.agent_known[:, [3, 6, 7, 8]].all(-1)
        use[:1] = False
        found.append(np.asarray(scene.agents, np.float64)[use][:, [3, 6, 7, 8]])
    return np.concatenate(found)


def random_lane_aligned(rng: np.random.Generator, scene: Scene, vehicles: Float[np.ndarray, "vehicles 4"]) -> Scene:
    """The baseline that only knows the lanes and the number of vehicles: every vehicle but the ego placed anew.

    Places are independent and uniform over the arc length of all lanes, headings follow the lane, speed and size come
    together from a random row of ``vehicles``. Agents of other classes are left out. Lanes and ego stay.

    Args:
      rng: source of the draws.
      scene: a single scene with at least one lane.
      vehicles: from ``vehicle_pool``, of training scenes.

    Raises:
      ValueError: without a lane, or with an empty pool.
    """
    (scene,) = singles(scene)
    if not len(vehicles):
        raise ValueError("the pool of vehicles is empty: build it with vehicle_pool from scenes that hold some")
    length = lane_lengths(scene).sum()
    if not length > 0:
        raise ValueError("vehicles are placed along lanes, but this scene has none of any length")
    count = int((scene.agent_types[1:] == AgentType.VEHICLE).sum())
    points, direction = places(segments(scene), rng.uniform(0.0, length, count))
    drawn = vehicles[rng.integers(len(vehicles), size=count)]
    placed = np.concatenate([points, drawn[:, :1], direction, drawn[:, 1:]], 1)
    placed[:, 2] += drawn[:, 3] / 2  # lanes lie on the ground, z of an agent is the centre of its box
    known = np.ones((count, 9), bool)
    known[:, 2] = bool(scene.lane_known[:, 2].all())
    return scene.replace(
        agents=np.concatenate([scene.agents[:1], placed.astype(np.float32)]),
        agent_types=np.concatenate([scene.agent_types[:1], np.full(count, AgentType.VEHICLE, np.int32)]),
        agent_mask=np.ones(1 + count, bool),
        agent_known=np.concatenate([scene.agent_known[:1], known]),
    )


def taking_part(
    scene: Scene, types: Sequence[AgentType] = tuple(AgentType), *, ego: bool = True, where: Where | None = None
) -> Bool[np.ndarray, " agents"]:
    """Which agents of one scene without padding are compared; the ego (agent 0, if the scene has one) is not."""
    kinds = np.array([int(kind) for kind in types])
    use = (np.asarray(scene.agent_types)[:, None] == kinds[None]).any(1)
    if ego:
        use[:1] = False
    return use if where is None else use & where(placed(scene)[:, :2])


def placed(scene: Scene) -> Float64[np.ndarray, "agents 3"]:
    """x, y [m] and class of all agents of one scene."""
    return np.concatenate([scene.agents[:, :2], scene.agent_types[:, None]], 1).astype(np.float64)


def distances(
    ours: Float64[np.ndarray, "ours 3"], theirs: Float64[np.ndarray, "theirs 3"], *, agnostic: bool = False
) -> Float64[np.ndarray, "ours theirs"]:
    """Between the centres of ``placed`` agents, infinite across classes unless ``agnostic``."""
    distance = np.linalg.norm(ours[:, None, :2] - theirs[None, :, :2], axis=-1)
    return distance if agnostic else np.where(ours[:, None, 2] == theirs[None, :, 2], distance, np.inf)


def hits(distance: Float64[np.ndarray, "ours theirs"], threshold: float) -> Bool[np.ndarray, " ours"]:
    """Rows in order take the nearest free column; which of them are nearer to it than ``threshold``."""
    found = np.zeros(len(distance), bool)
    if not distance.shape[1]:
        return found
    free = distance.copy()
    for row, near in enumerate(free):
        column = int(near.argmin())
        if near[column] < threshold:
            found[row] = True
            free[:, column] = np.inf
    return found
