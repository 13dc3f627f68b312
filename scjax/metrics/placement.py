"""Matches agents with a reference scene (match rate), and the random lane-aligned baseline."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64

from scjax.metrics.lanes import lane_arc_lengths, lane_segments, points_along
from scjax.metrics.pooling import Ratios, Values, pool, ratio, singles, values
from scjax.scene import AgentType, Scene

THRESHOLDS = (1.0, 2.0, 3.0)  # metres

Region = Callable[[Float64[np.ndarray, "agents 2"]], Bool[np.ndarray, " agents"]]
"""Positions x, y [m] -> which of them are compared."""


def field_of_view(half_angle: float = 50.0, apex: float = 0.0) -> Region:
    """The horizontal field of view of a camera at (``apex``, 0) [m]: within ``half_angle`` degrees of the x axis."""

    def inside(positions: Float64[np.ndarray, "agents 2"]) -> Bool[np.ndarray, " agents"]:
        ahead = positions[:, 0] - apex
        return (ahead > 0) & (np.abs(np.arctan2(positions[:, 1], ahead)) <= np.deg2rad(half_angle))

    return inside


def camera(focal: float, width: float, apex: float = 0.0) -> Region:
    """``field_of_view`` of a pinhole camera that looks along x; boxes are judged by their centers.

    Args:
      focal: focal length [pixels].
      width: image width [pixels].
      apex: distance of the camera ahead of the ego's center [m].
    """
    return field_of_view(float(np.rad2deg(np.arctan2(width / 2, focal))), apex)


def match(
    reference: Scene,
    generated: Scene,
    *,
    types: Sequence[AgentType] = tuple(AgentType),
    agnostic: bool = False,
    generated_ego: bool = True,
    region: Region | None = None,
) -> Ratios:
    """Matches the agents of one generated scene with those of its reference (metrics.md §3, ``match`` of the eval set).

    The ego (agent 0) of both sides is left out. In stored order, each generated agent takes the nearest unmatched
    reference agent of its class; the pair matches if the centers are closer than the threshold in xy.

    Args:
      reference: a single scene.
      generated: a single scene.
      types: classes that are compared.
      agnostic: whether agents match across classes.
      generated_ego: False if ``generated`` has no ego.
      region: agents of either side outside it are left out (``field_of_view`` for image conditions).

    Returns:
      "recall_1m" ...: (matches, reference agents); "precision_1m" ...: (matches, generated agents), per threshold.
    """
    (reference,), (generated,) = singles(reference), singles(generated)
    theirs = typed_positions(reference)[compared_agents(reference, types, region=region)]
    ours = typed_positions(generated)[compared_agents(generated, types, ego=generated_ego, region=region)]
    distance = distances(ours, theirs, agnostic=agnostic)
    ratios: Ratios = {}
    for threshold in THRESHOLDS:
        matched = float(greedy_matches(distance, threshold).sum())
        ratios[f"recall_{threshold:g}m"] = (matched, float(len(theirs)))
        ratios[f"precision_{threshold:g}m"] = (matched, float(len(ours)))
    return ratios


def match_summary(ratios: Ratios) -> Values:
    """Pooled recalls and precisions; M (match rate: mean recall), P (mean precision) and PxR (mean of the products)."""
    result = values(ratios)
    recalls = np.array([result[f"recall_{threshold:g}m"] for threshold in THRESHOLDS])
    precisions = np.array([result[f"precision_{threshold:g}m"] for threshold in THRESHOLDS])
    means = {"M": recalls.mean(), "P": precisions.mean(), "PxR": (recalls * precisions).mean()}
    return {**{name: float(mean) for name, mean in means.items()}, **result}


def placement(pairs: Iterable[tuple[Scene, Scene]], *, types: Sequence[AgentType] = tuple(AgentType)) -> Values:
    """``match_summary`` pooled over a stream of (reference, generated) pairs."""
    return match_summary(pool(match(reference, generated, types=types) for reference, generated in pairs))


def match_rate(reference: Scene, generated: Scene) -> float:
    """M of one pair of scenes over all classes; NaN if the reference has only the ego."""
    ratios = match(reference, generated)
    return float(np.mean([ratio(*ratios[f"recall_{threshold:g}m"]) for threshold in THRESHOLDS]))


def vehicle_pool(scenes: Scene | Iterable[Scene]) -> Float64[np.ndarray, "vehicles 4"]:
    """Speed [m/s], length, width, height [m] of all vehicles except egos and those with unknown values."""
    matched = [np.zeros((0, 4))]
    for scene in singles(scenes):
        use = (scene.agent_types == AgentType.VEHICLE) & scene.agent_known[:, [3, 6, 7, 8]].all(-1)
        use[:1] = False
        matched.append(np.asarray(scene.agents, np.float64)[use][:, [3, 6, 7, 8]])
    return np.concatenate(matched)


def random_lane_aligned(rng: np.random.Generator, scene: Scene, vehicles: Float[np.ndarray, "vehicles 4"]) -> Scene:
    """The random lane-aligned baseline: keeps lanes and ego, and places every other vehicle at random on a lane.

    Positions are independent and uniform over the arc length of all lanes; headings follow the lane; speed and size
    come from one random row of ``vehicles``. Agents of other classes are removed.

    Args:
      rng: random generator.
      scene: a single scene with at least one lane.
      vehicles: from ``vehicle_pool`` of training scenes.

    Raises:
      ValueError: the scene has no lane, or the pool is empty.
    """
    (scene,) = singles(scene)
    if not len(vehicles):
        raise ValueError("the pool of vehicles is empty: build it with vehicle_pool from scenes that hold some")
    length = lane_arc_lengths(scene).sum()
    if not length > 0:
        raise ValueError("vehicles are placed along lanes, but this scene has no lane with a length above 0")
    count = int((scene.agent_types[1:] == AgentType.VEHICLE).sum())
    points, direction = points_along(lane_segments(scene), rng.uniform(0.0, length, count))
    sizes = vehicles[rng.integers(len(vehicles), size=count)]
    vehicle_states = np.concatenate([points, sizes[:, :1], direction, sizes[:, 1:]], 1)
    vehicle_states[:, 2] += sizes[:, 3] / 2  # lanes lie on the ground; z of an agent is the center of its box
    known = np.ones((count, 9), bool)
    known[:, 2] = bool(scene.lane_known[:, 2].all())
    return scene.replace(
        agents=np.concatenate([scene.agents[:1], vehicle_states.astype(np.float32)]),
        agent_types=np.concatenate([scene.agent_types[:1], np.full(count, AgentType.VEHICLE, np.int32)]),
        agent_mask=np.ones(1 + count, bool),
        agent_known=np.concatenate([scene.agent_known[:1], known]),
    )


def compared_agents(
    scene: Scene, types: Sequence[AgentType] = tuple(AgentType), *, ego: bool = True, region: Region | None = None
) -> Bool[np.ndarray, " agents"]:
    """Which agents of one scene without padding are compared; with ``ego``, agent 0 is left out."""
    type_ids = np.array([int(agent_type) for agent_type in types])
    use = (np.asarray(scene.agent_types)[:, None] == type_ids[None]).any(1)
    if ego:
        use[:1] = False
    return use if region is None else use & region(typed_positions(scene)[:, :2])


def typed_positions(scene: Scene) -> Float64[np.ndarray, "agents 3"]:
    """x, y [m] and class of all agents of one scene."""
    return np.concatenate([scene.agents[:, :2], scene.agent_types[:, None]], 1).astype(np.float64)


def distances(
    ours: Float64[np.ndarray, "ours 3"], theirs: Float64[np.ndarray, "theirs 3"], *, agnostic: bool = False
) -> Float64[np.ndarray, "ours theirs"]:
    """Distances [m] between ``typed_positions`` of two scenes; infinite across classes unless ``agnostic``."""
    distance = np.linalg.norm(ours[:, None, :2] - theirs[None, :, :2], axis=-1)
    return distance if agnostic else np.where(ours[:, None, 2] == theirs[None, :, 2], distance, np.inf)


def greedy_matches(distance: Float64[np.ndarray, "ours theirs"], threshold: float) -> Bool[np.ndarray, " ours"]:
    """Greedy matching: rows in order take the nearest unmatched column; True where it is closer than ``threshold``."""
    matched = np.zeros(len(distance), bool)
    if not distance.shape[1]:
        return matched
    free = distance.copy()
    for row, near in enumerate(free):
        column = int(near.argmin())
        if near[column] < threshold:
            matched[row] = True
            free[:, column] = np.inf
    return matched
