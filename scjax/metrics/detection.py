"""Average precision of generated agents: the same matches as ``placement``, in the order of a score (metrics.md §3).

A generator has no scores, so the score is a choice, and with any score that knows nothing AP falls to about P * R.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64

from scjax.metrics.placement import THRESHOLDS, Where, distances, hits, placed, taking_part
from scjax.metrics.pooling import Values, singles
from scjax.scene import AgentType, Scene

_RECALLS = np.linspace(0, 1, 101)
_LEAST = 0.1  # recall and precision below which the nuScenes rule counts nothing
CONSENSUS = 2.0  # metres


class Detections(NamedTuple):
    """Generated agents of one scene or many: their score, whether each is a match per threshold, and the reference."""

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
    where: Where | None = None,
) -> Detections:
    """Matches of one generated scene; higher scores choose first, equal ones in stored order.

    Args:
      score: of every agent of ``generated`` (padding left out, the ego included if it has one); None takes the negative
        distance to the origin.

    Other arguments as in ``placement.match``.
    """
    (reference,), (generated,) = singles(reference), singles(generated)
    if score is None:
        score = -np.linalg.norm(np.asarray(generated.agents, np.float64)[:, :2], axis=-1)
    use = taking_part(generated, types, ego=generated_ego, where=where)
    ours, theirs = placed(generated)[use], placed(reference)[taking_part(reference, types, where=where)]
    own = np.asarray(score, np.float64)[use]
    order = np.argsort(-own, kind="stable")
    distance = distances(ours[order], theirs, agnostic=agnostic)
    hit = np.stack([hits(distance, threshold) for threshold in THRESHOLDS], 1)
    return Detections(own[order], hit, len(theirs))


def consensus(sample: Scene, siblings: Iterable[Scene]) -> Float64[np.ndarray, " agents"]:
    """Score of every agent of ``sample``: share of the other samples of its condition with the like within 2 m."""
    (sample,) = singles(sample)
    ours = placed(sample)
    near = [
        (distances(ours, placed(sibling)[taking_part(sibling)]) < CONSENSUS).any(1) for sibling in singles(siblings)
    ]
    return np.mean(near, 0) if near else np.zeros(len(ours))


def average_precision(scenes: Iterable[Detections]) -> Values:
    """Over all scenes pooled, each the mean over the thresholds; NaN without any reference agent.

    Returns:
      nuscenes: precision above 0.1 at recalls above 0.1, as the nuScenes detection task integrates it.
      interp101: mean over 101 recalls of the best precision at that recall or a higher one.
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
    found = np.cumsum(hit)
    return found / references, found / np.arange(1, len(hit) + 1)


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
