"""Reconstruction errors of an autoencoder, element by element (matched by index).

The ego is left out of position and heading errors: both are zero by definition of the frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from jaxtyping import Array, Shaped

from scjax.metrics.pooling import Ratios, Values, pool, singles, values
from scjax.scene import Link, Scene, Signal

_LINKS = {"link_f1": Link.PREDECESSOR, "link_f1_left": Link.LEFT, "link_f1_right": Link.RIGHT}
_SIZES = ("length_m", "width_m", "height_m")


def reconstruction_errors(scene: Scene, decoded: Scene) -> Ratios:
    """Error sums of one scene; element i of ``decoded`` reconstructs element i of ``scene``.

    Values count where both sides know them (``agent_known``, ``lane_known``); signals count where recorded.

    Returns:
      lane_point_m: xy distance of lane points [m]. lane_z_m: |z| of lane points [m].
      agent_centre_m: xy distance of centers; agent_z_m; heading_deg: |wrapped difference| (ego excluded).
      speed_mps, length_m, width_m, height_m: absolute differences (ego included).
      agent_type_accuracy; signal_accuracy: over recorded signals.
      link_f1, link_f1_left, link_f1_right: 2 TP / (true + predicted links) of predecessor (equivalently successor),
        left and right links, over ordered pairs of lanes.

    Raises:
      ValueError: the two have different numbers of agents or lanes.
    """
    (scene,), (decoded,) = singles(scene), singles(decoded)
    for name in ("agent_mask", "lane_mask"):
        if getattr(scene, name).shape != getattr(decoded, name).shape:
            raise ValueError(
                f"{name} of the scene and its reconstruction count {len(getattr(scene, name))} and "
                f"{len(getattr(decoded, name))} elements: errors are matched by index, decode without dropping any"
            )
    return {**_lane_errors(scene, decoded), **_agent_errors(scene, decoded), **_link_scores(scene, decoded)}


def error_summary(ratios: Ratios) -> Values:
    """Pooled values, and link_f1_macro: mean F1 over those of predecessor, left and right links that occur."""
    result = values(ratios)
    scores = [result[name] for name in _LINKS if name in result and not math.isnan(result[name])]
    return {**result, "link_f1_macro": float(np.mean(scores)) if scores else math.nan}


def reconstruction(pairs: Iterable[tuple[Scene, Scene]]) -> Values:
    """``error_summary`` pooled over a stream of (scene, decoded) pairs."""
    return error_summary(pool(reconstruction_errors(scene, decoded) for scene, decoded in pairs))


def _lane_errors(scene: Scene, decoded: Scene) -> Ratios:
    points, decoded_values = scene.lanes.astype(np.float64), decoded.lanes.astype(np.float64)
    known = scene.lane_known & decoded.lane_known
    distance = np.linalg.norm(points[..., :2] - decoded_values[..., :2], axis=-1)
    recorded = scene.signals != Signal.UNKNOWN
    return {
        "lane_point_m": _total(distance[known[:, :2].all(-1)]),
        "lane_z_m": _total(np.abs(points - decoded_values)[known[:, 2], :, 2]),
        "signal_accuracy": _total((scene.signals == decoded.signals)[recorded]),
    }


def _agent_errors(scene: Scene, decoded: Scene) -> Ratios:
    agents, decoded_values = scene.agents.astype(np.float64), decoded.agents.astype(np.float64)
    known = scene.agent_known & decoded.agent_known
    others = known.copy()
    others[:1] = False
    difference = np.abs(agents - decoded_values)
    turn = np.arctan2(agents[:, 5], agents[:, 4]) - np.arctan2(decoded_values[:, 5], decoded_values[:, 4])
    degrees = np.abs(np.rad2deg(np.arctan2(np.sin(turn), np.cos(turn))))
    errors = {
        "agent_centre_m": _total(np.linalg.norm(agents[:, :2] - decoded_values[:, :2], axis=-1)[others[:, :2].all(-1)]),
        "agent_z_m": _total(difference[others[:, 2], 2]),
        "heading_deg": _total(degrees[others[:, 4:6].all(-1)]),
        "speed_mps": _total(difference[known[:, 3], 3]),
        "agent_type_accuracy": _total(scene.agent_types == decoded.agent_types),
    }
    return errors | {name: _total(difference[known[:, 6 + i], 6 + i]) for i, name in enumerate(_SIZES)}


def _link_scores(scene: Scene, decoded: Scene) -> Ratios:
    scores = {}
    for name, link in _LINKS.items():
        true, predicted = scene.links == link, decoded.links == link
        scores[name] = (2.0 * float((true & predicted).sum()), float(true.sum() + predicted.sum()))
    return scores


def _total(errors: Shaped[Array | np.ndarray, ...]) -> tuple[float, float]:
    return float(errors.sum()), float(errors.size)
