"""Average precision (AP) of generated agents: the matches of ``placement``, ordered by a score (metrics.md §3).

A generator gives no scores. With any uninformative score, AP falls to about P * R.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64

from scjax.metrics.placement import THRESHOLDS, Region, compared_agents, distances, greedy_matches, typed_positions
from scjax.metrics.pooling import Values, singles
from scjax.scene import AgentType, Scene

_RECALLS = np.linspace(0, 1, 101)
_LEAST = 0.1  # the nuScenes rule ignores recall and precision below this
CONSENSUS = 2.0  # metres between agents that agree


class Detections(NamedTuple):
    """Generated agents of one or more scenes: scores, matches per threshold, and the number of reference agents."""

    score: Float64[np.ndarray, " agents"]
    hit: Bool[np.ndarray, "agents thresholds"]
    references: int


def detections(
    reference: Scene,
    generated: Scene,
    score: Float[np.ndarray, " agents"] | None = None,
    *,
    types: Sequence[AgentType] = tuple(AgentType),
    agnostic: bool = False,
    generated_ego: bool = True,
    region: Region | None = None,
) -> Detections:
    """Matches the agents of one generated scene in order of falling score; ties in stored order.

    Args:
      score: of every agent of ``generated`` without padding, including the ego; None: negative distance to the origin.

    Other arguments as in ``placement.match``.
    """
    (reference,), (generated,) = singles(reference), singles(generated)
    if score is None:
        score = -np.linalg.norm(np.asarray(generated.agents, np.float64)[:, :2], axis=-1)
    use = compared_agents(generated, types, ego=generated_ego, region=region)
    ours, theirs = (
        typed_positions(generated)[use],
        typed_positions(reference)[compared_agents(reference, types, region=region)],
    )
    own = np.asarray(score, np.float64)[use]
    order = np.argsort(-own, kind="stable")
    distance = distances(ours[order], theirs, agnostic=agnostic)
    hit = np.stack([greedy_matches(distance, threshold) for threshold in THRESHOLDS], 1)
    return Detections(own[order], hit, len(theirs))


def consensus(sample: Scene, siblings: Iterable[Scene]) -> Float64[np.ndarray, " agents"]:
    """Score of every agent: share of ``siblings`` with an agent of the same class within 2 m.

    Args:
      sample: a single scene.
      siblings: other samples of the same condition.
    """
    (sample,) = singles(sample)
    ours = typed_positions(sample)
    near = [
        (distances(ours, typed_positions(sibling)[compared_agents(sibling)]) < CONSENSUS).any(1)
        for sibling in singles(siblings)
    ]
    return np.mean(near, 0) if near else np.zeros(len(ours))


def average_precision(scenes: Iterable[Detections]) -> Values:
    """Average precision over all scenes, mean over the thresholds; NaN without reference agents.

    Returns:
      nuscenes: as in the nuScenes detection task, which counts precision above 0.1 at recalls above 0.1.
      interp101: mean over 101 recalls of the highest precision at that or a higher recall.
    """
    parts = list(scenes)
    total = sum(part.references for part in parts)
    if not total:
        return {"nuscenes": float("nan"), "interp101": float("nan")}
    score = np.concatenate([part.score for part in parts])
    hit = np.concatenate([part.hit for part in parts])[np.argsort(-score, kind="stable")]
    curves = [_curve(column, total) for column in hit.T]
    return {
        "nuscenes": float(np.mean([_nuscenes(*curve) for curve in curves])),
        "interp101": float(np.mean([_interp101(*curve) for curve in curves])),
    }


def _curve(hit: np.ndarray, references: int) -> tuple[np.ndarray, np.ndarray]:
    """Recall and precision after every prediction."""
    matches = np.cumsum(hit)
    return matches / references, matches / np.arange(1, len(hit) + 1)


def _nuscenes(recall: np.ndarray, precision: np.ndarray) -> float:
    if not len(recall):
        return 0.0
    curve = np.interp(_RECALLS, recall, precision, right=0)[round(100 * _LEAST) + 1 :]
    return float(np.maximum(curve - _LEAST, 0).mean() / (1 - _LEAST))


def _interp101(recall: np.ndarray, precision: np.ndarray) -> float:
    best = np.maximum.accumulate(precision[::-1])[::-1]  # the best precision from here on
    row = np.searchsorted(recall, _RECALLS, side="left")
    return (
        float(np.where(row < len(recall), best[np.minimum(row, len(recall) - 1)], 0.0).mean()) if len(recall) else 0.0
    )
