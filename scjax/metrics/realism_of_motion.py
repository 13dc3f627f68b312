"""How likely recorded motion is under simulated motion: the metrics of the Waymo Open Sim Agents Challenge (WOSAC).

Definition: Montali et al. 2023, with the features, bins and weights of the challenge of 2025.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from scjax.metrics.distributions import Sums
from scjax.metrics.motion_features import Feature, motion_features
from scjax.metrics.motion_likelihood import BUCKETS, FEATURES, INDICATION, WEIGHTS_2025, log_likelihoods
from scjax.metrics.object_boxes import ObjectBoxes, object_boxes
from scjax.metrics.pooling import Values, ratio
from scjax.metrics.road_distance import RoadDistance
from scjax.scene import AgentType, Log

_MEASURED = (AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.CYCLIST)
_RATES = {"collision": "collision_indication", "offroad": "offroad_indication", "red_light": "traffic_light_violation"}


def realism_of_motion(
    logged: Log,
    simulated: Sequence[Log],
    *,
    history: int = 1,
    weights: Mapping[str, float] = WEIGHTS_2025,
) -> Sums:
    """Contribution of one scene: (value, 1) [2] for each metric, or (0, 0) where it is not defined.

    Objects match by their ids. Measured are vehicles, pedestrians and cyclists that the log has at its last known step
    (``history - 1``), at the later steps at which the log has them.

    - An object that a roll-out adds is an obstacle for the others, and is not measured itself.
    - Where a roll-out lacks an object, or removes it early, it gives no values: the histogram of the object has those
      of the other steps and roll-outs. Without any it is uniform. ``presence`` says how much is there.
    - A collision, a departure from the road or a violation counts if it happens at any step at which log and roll-out
      have the object. Roll-outs that never have it do not count. Overlaps of the first step count like others.

    A likelihood is exp(mean log probability over objects and steps); of indications over objects. The meta-metric is
    the weighted mean of those that are defined: without lanes, signals or vehicles some are not.

    Args:
      logged: the recording.
      simulated: roll-outs of the same scene, on the same steps; the challenge has 32.
      history: number of first steps that roll-outs repeat and that are not measured; 11 in the challenge.
      weights: of the likelihoods in the meta-metric.

    Returns:
      "<feature>_likelihood", "<bucket>_likelihood" and "metametric", all in [0, 1]; "min_ade" and "ade": displacement
      [m], over objects and steps, of the best roll-out and the mean; "<rate>_simulated" and "<rate>_logged" for
      collision, offroad and red_light: objects with one / objects; "presence".

    Raises:
      ValueError: no roll-outs; other steps than the log; ``history`` out of range; NaN at valid steps.
    """
    _check(logged, simulated, history, weights)
    boxes = object_boxes(logged)
    rows = np.flatnonzero(boxes.valid[:, history - 1] & np.isin(boxes.types, _MEASURED))
    sides = [(log, object_boxes(log), _matches(logged, log, rows)) for log in simulated]
    road = RoadDistance(logged.lanes)
    truth = motion_features(logged, boxes, rows, road)
    rollouts = [_features_of(log, own, matches, logged, road) for log, own, matches in sides]
    sums: Sums = {}
    measured = boxes.valid[rows, history:]
    for name, spec in FEATURES.items():
        log_feature, sim = truth[name], [rollout[name] for rollout in rollouts]
        values = np.stack([feature.values for feature in sim])[..., history:]
        valid = np.stack([feature.valid for feature in sim])[..., history:]
        target, counted = log_feature.values[:, history:], log_feature.valid[:, history:]
        if name == "traffic_light_violation" and not logged.signal_lane_ids:
            counted, valid = np.zeros_like(counted), np.zeros_like(valid)
        if spec is INDICATION:
            target, values, counted, valid = _any_time(target, values, counted, valid)
        likelihood = log_likelihoods(target, values, valid, spec)[counted]
        sums[f"{name}_likelihood"] = _one(np.exp(likelihood.mean()) if len(likelihood) else np.nan)
        for rate in (rate for rate, feature in _RATES.items() if feature == name):
            sums[f"{rate}_simulated"] = np.array([float(values[valid].sum()), float(valid.sum())])
            sums[f"{rate}_logged"] = np.array([float(target[counted].sum()), float(counted.sum())])
    for bucket, names in BUCKETS.items():
        sums[f"{bucket}_likelihood"] = _one(_mean(sums, names, weights))
    sums["metametric"] = _one(_mean(sums, tuple(FEATURES), weights))
    return sums | _displacements(boxes, rows, sides, measured, history)


def realism_of_motion_table(sums: Sums) -> Values:
    """Means over scenes from the added sums of ``realism_of_motion``; rates pool objects. NaN where not defined."""
    return {name: ratio(float(value[0]), float(value[1])) for name, value in sums.items()}


def _check(logged: Log, simulated: Sequence[Log], history: int, weights: Mapping[str, float]) -> None:
    if not simulated:
        raise ValueError("simulated holds no roll-outs: give at least one")
    if not 1 <= history < logged.num_steps:
        raise ValueError(f"history is {history}: give a number from 1 to {logged.num_steps - 1}, fewer than all steps")
    if unknown := sorted(set(weights) - set(FEATURES)):
        raise ValueError(f"weights names the unknown feature {unknown[0]!r}: choose of {', '.join(FEATURES)}")
    for number, log in enumerate(simulated):
        if log.num_steps != logged.num_steps or abs(log.dt - logged.dt) > 0.01 * logged.dt:
            raise ValueError(
                f"simulated[{number}] has {log.num_steps} steps of {log.dt:.3g} s, but the log has {logged.num_steps} "
                f"of {logged.dt:.3g} s: give roll-outs on its steps (Log.select_steps)"
            )


def _matches(logged: Log, log: Log, rows: np.ndarray) -> np.ndarray:
    """Index of each of some logged objects in another log; -1 where that lacks it."""
    places = {name: row for row, name in enumerate(log.object_ids)}
    return np.array([places.get(logged.object_ids[row], -1) for row in rows], int)


def _features_of(
    log: Log, boxes: ObjectBoxes, matches: np.ndarray, logged: Log, road: RoadDistance
) -> dict[str, Feature]:
    """Features of the matches of the logged objects; invalid where there is none."""
    lanes = road if log.lanes is logged.lanes else RoadDistance(log.lanes)
    present = matches >= 0
    parts = motion_features(log, boxes, matches[present], lanes)
    features = {}
    for name, part in parts.items():
        values, valid = np.zeros((len(matches), log.num_steps)), np.zeros((len(matches), log.num_steps), bool)
        values[present], valid[present] = part
        features[name] = Feature(values, valid)
    return features


def _any_time(
    target: np.ndarray, values: np.ndarray, counted: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Whether it happens at any step at which log and roll-out have the object; one step each."""
    both = valid & counted
    happens = ((values > 0) & both).any(-1, keepdims=True).astype(float)
    logged = ((target > 0) & counted).any(-1, keepdims=True).astype(float)
    return logged, happens, np.asarray(counted.any(-1, keepdims=True)), np.asarray(both.any(-1, keepdims=True))


def _one(value: float) -> np.ndarray:
    return np.array([value, 1.0]) if np.isfinite(value) else np.zeros(2)


def _mean(sums: Sums, names: Sequence[str], weights: Mapping[str, float]) -> float:
    """Weighted mean of the likelihoods that are defined; NaN without any."""
    parts = [(weights.get(name, 0.0), sums[f"{name}_likelihood"]) for name in names]
    total = sum(weight for weight, (_, count) in parts if count)
    return sum(weight * value for weight, (value, _) in parts) / total if total else float("nan")


def _displacements(
    boxes: ObjectBoxes,
    rows: np.ndarray,
    sides: Sequence[tuple[Log, ObjectBoxes, np.ndarray]],
    measured: np.ndarray,
    history: int,
) -> Sums:
    """Displacement errors and the share of the logged steps at which roll-outs have the objects."""
    errors, there = [], 0
    for _, own, matches in sides:
        both = measured & own.valid[matches, history:] & (matches >= 0)[:, None]
        there += int(both.sum())
        apart = np.linalg.norm(own.positions[matches, history:] - boxes.positions[rows, history:], axis=-1)
        seen = both.any(-1)
        means = np.where(both, apart, 0.0).sum(-1)[seen] / both.sum(-1)[seen]
        errors.append(means.mean() if seen.any() else np.nan)
    known = np.array(errors)[np.isfinite(errors)]
    return {
        "ade": _one(known.mean() if len(known) else np.nan),
        "min_ade": _one(known.min() if len(known) else np.nan),
        "presence": np.array([float(there), float(len(sides) * measured.sum())]),
    }
