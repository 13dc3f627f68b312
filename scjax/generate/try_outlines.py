"""Samples from the outlines of a model, to know what the model makes of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from scjax.generate.best_of import count_lane_faults
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.outline_draw import valid_tokens
from scjax.generate.outlines import Outlines
from scjax.generate.requests import Request
from scjax.generate.sample import sample_requests, sampling_settings
from scjax.generate.scene_spec import SceneSpec, specify_scenes
from scjax.language.attributes.draw import draw_attributes
from scjax.language.attributes.table import measure_attributes
from scjax.metrics.realism import connection_gaps
from scjax.scene.per_type import PerType


class Trial(NamedTuple):
    """A raw single sample from an outline: its attributes (``measure_attributes``), and ``count_lane_faults``."""

    measured: Mapping[str, Any]
    faults: int


def try_outlines(model: Model, rows: Sequence[int], trial: int, seed: int = 0) -> list[Trial]:
    """One sample from each of some outlines, with a random request that the outline's scene fulfills, as in training.

    Args:
      rows: numbers of the outlines.
      trial: its number; the requests depend on it and the row, the samples on ``seed``, too.

    Raises:
      ValueError: the model has no outlines.
    """
    outlines = model.outlines
    if outlines is None:
        raise ValueError("the model has no outlines to try: train a denoiser with agent_kinds=True on requests")
    settings = sampling_settings(model, None, None, None, None, False)
    requests = [draw_attributes(outlines.measurements(row), np.random.default_rng([trial, row])) for row in rows]
    conditions = [Condition(attributes=request) for request in requests]
    key = jax.random.key(seed + trial)
    specs = specify_scenes(conditions, model)
    drawn = [_request(jax.random.fold_in(key, row), spec, outlines, row) for row, spec in zip(rows, specs, strict=True)]
    return [
        Trial(measure_attributes(scene), count_lane_faults(scene, connection_gaps(scene)))
        for scene in sample_requests(drawn, model, settings)
    ]


def _request(key: jax.Array, spec: SceneSpec, outlines: Outlines, row: int) -> Request:
    agents, lanes = (valid_tokens(kinds[row]) for kinds in (outlines.agents, outlines.lanes))
    kinds = PerType(agents=agents, lanes=lanes)
    return Request(key, spec, int(outlines.domains[row]), len(agents), len(lanes), kinds)
