"""Scenes of one run, and what the evaluation's metrics say of them."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax

import scjax
from experiments.studies.ablation.requests import Requests
from scjax.generate.conditions import Condition
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import check
from scjax.metrics.measure import control_values, distribution_values, match_values, measure, scene_values
from scjax.metrics.placement import field_of_view
from scjax.metrics.pooling import Values, ratio
from scjax.metrics.scene_stats import SceneStats
from scjax.scene import Crop, Scene, stack, unpadded
from scjax.scene.io import load_npz, save_npz

CALL = 64  # scenes a call of the sampler

# Name -> title, and whether more is better.
METRICS = {
    "control": ("control: mean of the next two", True),
    "lane CCS": ("CCS of lanes", True),
    "agent CCS": ("CCS of agents", True),
    "lane CSC": ("CSC of lanes", True),
    "agent CSC": ("CSC of agents", True),
    "prompt": ("what the prompt asks for", True),
    "loss": ("loss at equal noise", False),
    "M": ("agents matched", True),
    "vehicles_overlapping": ("vehicles that overlap", False),
    "vehicles_on_lane": ("vehicles within 1.5 m of a lane", True),
    "open_connections": ("joints open by more than 1 m", False),
    "frechet_connectivity": ("connectivity of the lane graph", False),
    "nearest_dist_jsd": ("distance to the next vehicle", False),
    "speed_jsd": ("speeds", False),
}
HEADLINE = {"text": "prompt", "image": "control"}
"""By which a mechanism has to beat no condition and its shuffled twin: what is asked, where words can be checked."""
DIGITS = {"loss": 4}  # of its mean in tables, where that is not 3: a condition decides little of it, but surely


class Sampler(NamedTuple):
    """How scenes are drawn."""

    name: str
    steps: int
    guidance: float


def sampled(
    model: scjax.Model, conditions: Sequence[Condition], how: Sampler, seed: int, path: Path
) -> tuple[list[Scene], float]:
    """A scene a condition, kept in a file; and seconds a scene of the calls that had nothing to compile (NaN if none).

    Equal seeds draw equal noise for the same place in the list, whatever the condition.
    """
    seconds = path.with_suffix(".seconds")
    if not path.exists():
        scenes, times = [], []
        for start in range(0, len(conditions), CALL):
            begin, part = time.perf_counter(), conditions[start : start + CALL]
            scenes += scjax.sample(
                jax.random.fold_in(jax.random.key(seed), start),
                part,
                model=model,
                sampler=how.name,
                num_steps=how.steps,
                guidance=how.guidance,
            )
            times.append((time.perf_counter() - begin) / len(part))
        seconds.write_text(str(min(times[1:], default=math.nan)))
        save_npz(stack(scenes), path)
    batch = load_npz(path)
    return [unpadded(batch[row]) for row in range(len(conditions))], float(seconds.read_text())


def values_of(scenes: Sequence[Scene], requests: Requests, real: SceneStats, loss: float) -> Values:
    """``METRICS``; NaN where one has nothing to measure. Agents are matched in the field of view of an image.

    Args:
      loss: mean of ``denoising_losses`` over the references.
    """
    ahead = int(requests.references[0].crop) == Crop.FORWARD
    found = measure(scenes, requests.clusters, requests.references, region=field_of_view() if ahead else None)
    sums = found.cluster_sums.total
    values = distribution_values(sums, real.cluster_sums.total, "strict") | scene_values(sums) | match_values(sums)
    values |= control_values(found, real, shuffles=0)
    values["control"] = (values["lane CCS"] + values["agent CCS"]) / 2
    answers = scenes[: len(requests.asked)]  # images ask for nothing in words
    hits = [
        good
        for asked, scene in zip(requests.asked, answers, strict=True)
        for good in check(asked, extract_facts(scene)).values()
    ]
    values["prompt"], values["loss"] = ratio(float(sum(hits)), float(len(hits))), loss
    return {name: float(values.get(name, math.nan)) for name in METRICS}
