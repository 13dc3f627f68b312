"""Scenes of one run, and their metrics."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax

import scjax
from experiments.studies.ablation.requests import Requests
from experiments.studies.prompts import count_shown
from scjax.generate.conditions import Condition
from scjax.metrics.measure import control_values, distribution_values, match_values, measure, scene_values
from scjax.metrics.placement import field_of_view
from scjax.metrics.pooling import Values, ratio
from scjax.metrics.scene_stats import SceneStats
from scjax.scene import Crop, Scene, stack, unpadded
from scjax.scene.io import load_npz, save_npz

_SCENES_PER_CALL = 64


class Metric(NamedTuple):
    """Title of a metric, and whether more is better."""

    title: str
    more_is_better: bool


METRICS = {
    "control": Metric("control: mean of the next two", True),
    "lane CCS": Metric("CCS of lanes", True),
    "agent CCS": Metric("CCS of agents", True),
    "lane CSC": Metric("CSC of lanes", True),
    "agent CSC": Metric("CSC of agents", True),
    "prompt": Metric("what the prompt asks for", True),
    "loss": Metric("loss at equal noise", False),
    "M": Metric("agents matched", True),
    "vehicles_overlapping": Metric("vehicles that overlap", False),
    "vehicles_on_lane": Metric("vehicles within 1.5 m of a lane", True),
    "open_connections": Metric("connections open by more than 1 m", False),
    "frechet_connectivity": Metric("connectivity of the lane graph", False),
    "nearest_dist_jsd": Metric("distance to the next vehicle", False),
    "speed_jsd": Metric("speeds", False),
}
HEADLINE = {"text": "prompt", "image": "control"}
"""Modality -> metric in which a mechanism has to exceed no condition and shuffled conditions."""
DIGITS = {"loss": 4}  # decimals in tables, where not 3: conditions change the loss little, but reliably


class SamplerSettings(NamedTuple):
    """How scenes are sampled."""

    name: str
    num_steps: int
    guidance: float


def sample_to_file(
    model: scjax.Model,
    conditions: Sequence[Condition],
    settings: SamplerSettings,
    seed: int,
    path: Path,
    padded_size: tuple[int, int] = (0, 0),
) -> tuple[list[Scene], float]:
    """One scene per condition, stored in a file, and seconds per scene of calls without compilation (NaN if none).

    Equal seeds give equal noise at the same position of the list, whatever the condition. Scenes are padded to
    ``padded_size`` (agents, lanes) at least.
    """
    seconds = path.with_suffix(".seconds")
    if not path.exists():
        scenes, times = [], []
        for start in range(0, len(conditions), _SCENES_PER_CALL):
            begin, part = time.perf_counter(), conditions[start : start + _SCENES_PER_CALL]
            scenes += scjax.sample(
                jax.random.fold_in(jax.random.key(seed), start),
                part,
                model=model,
                sampler=settings.name,
                num_steps=settings.num_steps,
                guidance=settings.guidance,
                energy_guidance=False,  # whatever the autoencoder's model has by default
                padded_size=padded_size,
            )
            times.append((time.perf_counter() - begin) / len(part))
        seconds.write_text(str(min(times[1:], default=math.nan)))
        save_npz(stack(scenes), path)
    batch = load_npz(path)
    return [unpadded(batch[row]) for row in range(len(conditions))], float(seconds.read_text())


def measure_run(scenes: Sequence[Scene], requests: Requests, real: SceneStats, loss: float) -> Values:
    """The values of ``METRICS``; NaN where undefined. For images, agents are matched in the field of view.

    Args:
      scenes: one per request.
      requests: what they were sampled for.
      real: statistics of the references.
      loss: mean of ``denoising_losses`` over the references.
    """
    ahead = int(requests.references[0].crop) == Crop.FORWARD
    stats = measure(scenes, requests.clusters, requests.references, region=field_of_view() if ahead else None)
    sums = stats.cluster_sums.total
    values = distribution_values(sums, real.cluster_sums.total, "strict") | scene_values(sums) | match_values(sums)
    values |= control_values(stats, real, shuffles=0)
    values["control"] = (values["lane CCS"] + values["agent CCS"]) / 2
    # Images ask for nothing in words: they have no requests.
    counts = [count_shown(scene, request) for request, scene in zip(requests.requests, scenes, strict=False)]
    values["prompt"], values["loss"] = ratio(*map(sum, zip(*counts, strict=True))) if counts else math.nan, loss
    return {name: float(values.get(name, math.nan)) for name in METRICS}
