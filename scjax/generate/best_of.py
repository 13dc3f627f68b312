"""The best of several candidates for one scene, by the attributes that it shall show and by its faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.language.attributes.table import score_attributes
from scjax.metrics.realism import ON_LANE, OPEN_CONNECTION, connection_gaps, lane_offsets, overlapping_pairs
from scjax.scene import Scene
from scjax.scene.loose_ends import loose_ends

_AGAINST = 90.0  # degrees between a vehicle and its lane


class SceneScore(NamedTuple):
    """What is wrong with a scene. Less is better; earlier fields decide first.

    Attributes:
      missed: attributes that are requested and that the scene does not show, plus one if the ego is on no lane
        (fragments of lanes pass for much, such as for a curve); 0 without a request.
      faults: overlapping boxes, lane connections open by more than 1 m, loose ends of lanes, and vehicles on no lane
        or against theirs.
      gap: sum of the gaps at lane connections [m].
    """

    missed: int
    faults: int
    gap: float


def score_scene(scene: Scene, attributes: Mapping[str, Any]) -> SceneScore:
    """Scores a scene for the attributes that are requested; without any the faults alone count."""
    gaps, (offsets, angles) = connection_gaps(scene), lane_offsets(scene)
    missed = 0
    if attributes:
        missed = len(score_attributes(scene, attributes).misses) + int((offsets[:1] > ON_LANE).sum())
    misplaced = (offsets > ON_LANE) | (angles > _AGAINST)
    faults = len(overlapping_pairs(scene)) + count_lane_faults(scene, gaps) + int(misplaced.sum())
    return SceneScore(missed, faults, float(gaps.sum()))


def count_lane_faults(scene: Scene, gaps: Float64[np.ndarray, " connections"]) -> int:
    """Lane connections open by more than 1 m, of ``connection_gaps``, and loose ends of lanes."""
    return int((gaps > OPEN_CONNECTION).sum()) + len(loose_ends(scene))


def best_order(scenes: Sequence[Scene], attributes: Mapping[str, Any]) -> list[int]:
    """Indices of the scenes by ``score_scene``, the least first; equals keep their order.

    Raises:
      ValueError: there are no scenes.
    """
    if not scenes:
        raise ValueError("there are no scenes to choose from: give at least one")
    scores = [score_scene(scene, attributes) for scene in scenes]
    return sorted(range(len(scenes)), key=scores.__getitem__)


def best_index(scenes: Sequence[Scene], attributes: Mapping[str, Any]) -> int:
    """Index of the scene with the least ``score_scene``, the first of equals.

    Raises:
      ValueError: there are no scenes.
    """
    return best_order(scenes, attributes)[0]
