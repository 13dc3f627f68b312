"""Describes a scene by three vectors, of lanes, agents and the whole scene, for control metrics (metrics.md §4.2).

The first two describe the placement of elements, not their number. The ego is left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.metrics.lanes import lane_arc_lengths
from scjax.metrics.pooling import singles
from scjax.scene import AgentType, Scene

LEVELS = ("lane", "agent", "glob")
_SPREAD = 0.0246  # variance of the global descriptor about its constant 1: random pairs have cosine 1 / 1.0246
_CONSTANT = 1e-6  # coordinates with a smaller deviation are dropped
_CLASSES = (AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.CYCLIST)
_TURNING = 0.35  # rad between the first and the last chord of a lane
_STOPPED = 0.5  # m/s
_HEADING_BINS = 8


class Descriptor(NamedTuple):
    """Raw vectors of one scene, or of several with a leading axis: lanes [22], agents [20], whole scene [18]."""

    lane: np.ndarray
    agent: np.ndarray
    glob: np.ndarray


def describe(scenes: Scene | Iterable[Scene], *, ego: bool = True) -> Descriptor:
    """Raw descriptors of scenes, [scenes, .] each; with ``ego``, agent 0 is the ego and is left out."""
    rows = [
        Descriptor(_pooled(_lane_features(s)), _pooled(_agent_features(s, ego)), _scene_statistics(s, ego))
        for s in singles(scenes)
    ]
    widths = (22, 20, 18)
    return Descriptor(*(np.array([row[k] for row in rows]).reshape(-1, width) for k, width in enumerate(widths)))


@dataclasses.dataclass(frozen=True)
class Standard:
    """Standardization: mean and (population) deviation of every coordinate over a reference set."""

    mean: Descriptor
    deviation: Descriptor

    @classmethod
    def of(cls, descriptors: Descriptor) -> Standard:
        """From the raw descriptors of the reference set.

        Raises:
          ValueError: the set is empty.
        """
        if not len(descriptors.lane):
            raise ValueError("descriptors are standardized over a reference set, but it is empty: give its scenes")
        return cls(Descriptor(*(x.mean(0) for x in descriptors)), Descriptor(*(x.std(0) for x in descriptors)))

    def __call__(self, raw: Descriptor) -> Descriptor:
        """z-scores without constant coordinates; the global descriptor is scaled and gets a leading constant 1."""
        lane, agent, glob = (
            ((x - mean) / np.where(deviation > _CONSTANT, deviation, 1.0))[:, deviation > _CONSTANT]
            for x, mean, deviation in zip(raw, self.mean, self.deviation, strict=True)
        )
        glob = np.sqrt(_SPREAD / max(glob.shape[1], 1)) * glob
        return Descriptor(lane, agent, np.concatenate([np.ones((len(glob), 1)), glob], 1))


def _pooled(features: Float64[np.ndarray, "elements features"]) -> Float64[np.ndarray, " twice_features"]:
    """Mean and deviation over elements; zeros without elements."""
    if not len(features):
        return np.zeros(2 * features.shape[1])
    return np.concatenate([features.mean(0), features.std(0)])


def _lane_features(scene: Scene) -> Float64[np.ndarray, "lanes 11"]:
    points = np.asarray(scene.lanes, np.float64)[..., :2]
    first, last = points[:, 1] - points[:, 0], points[:, -1] - points[:, -2]
    length = lane_arc_lengths(scene)[:, None]
    positions = [points[:, 0], points[:, 9], points[:, -1], length]
    return np.concatenate([*(position / 32 for position in positions), _direction(first), _direction(last)], 1)


def _agent_features(scene: Scene, ego: bool) -> Float64[np.ndarray, "agents 10"]:
    agents, types = np.asarray(scene.agents, np.float64)[int(ego) :], np.asarray(scene.agent_types)[int(ego) :]
    classes = np.stack([types == agent_type for agent_type in _CLASSES], 1)
    columns = [agents[:, :2] / 32, agents[:, 3:4] / 10, agents[:, 4:6], agents[:, 6:7] / 5, agents[:, 7:8] / 2]
    return np.concatenate([*columns, classes], 1)


def _scene_statistics(scene: Scene, ego: bool) -> Float64[np.ndarray, " 18"]:
    points, agents = np.asarray(scene.lanes, np.float64)[..., :2], np.asarray(scene.agents, np.float64)[int(ego) :]
    types, length = np.asarray(scene.agent_types)[int(ego) :], lane_arc_lengths(scene)
    chords = np.diff(points, axis=1)
    heading = np.arctan2(chords[..., 1], chords[..., 0])
    turn = _wrapped(heading[:, -1] - heading[:, 0])
    weight = np.linalg.norm(chords, axis=-1)
    directions = np.histogram(heading.ravel(), _HEADING_BINS, (-np.pi, np.pi), weights=weight.ravel())[0]
    counts = [float((types == agent_type).sum()) for agent_type in _CLASSES]
    lanes, others = len(points), len(agents)
    return np.array(
        [
            np.log1p(lanes),
            np.log1p(length.sum()),
            np.log1p(length.mean() if lanes else 0.0),
            float((np.abs(turn) > _TURNING).mean()) if lanes else 0.0,
            *(directions / (directions.sum() + 1e-9)),
            *np.log1p(counts),
            np.log1p(agents[:, 3].mean() if others else 0.0),
            float((agents[:, 3] < _STOPPED).mean()) if others else 0.0,
            np.log1p(others),
        ]
    )


def _direction(vectors: np.ndarray) -> np.ndarray:
    heading = np.arctan2(vectors[:, 1], vectors[:, 0])
    return np.stack([np.cos(heading), np.sin(heading)], 1)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.arctan2(np.sin(angle), np.cos(angle))
