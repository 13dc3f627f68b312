"""Rows of the field's tables for a report: distributions against real scenes, and control by what was asked for."""

from __future__ import annotations

import math

import numpy as np

from experiments.evaluation import Number, Row, Tiles
from scjax.metrics.control import ControlFrame
from scjax.metrics.descriptors import describe
from scjax.metrics.distributions import scene_sums, table
from scjax.metrics.tally import Tally
from scjax.metrics.topology import Mode

RETRIEVED = 5  # tiles of the nearest counts, of which one is drawn


def distribution_rows(populations: dict[str, Tiles], real: Tiles, bank: Tiles, mode: Mode) -> dict[str, Row]:
    """Every population against ``real``, and what two halves of the training tiles differ by, at as many scenes."""
    held = _tally(real, mode)
    rows = {}
    for name, tiles in populations.items():
        ours = _tally(tiles, mode)
        values, bounds = table(ours.total, held.total), ours.intervals(held, table)
        rows[name] = {
            metric: Number(value, *bounds[metric], None, len(tiles.scenes), len(ours.clusters))
            for metric, value in values.items()
        }
    # The floor falls with the number of scenes: take as many as a comparison has.
    number = min(2 * len(real.scenes), len(bank.scenes))
    part = bank[sorted(np.random.default_rng(0).choice(len(bank.scenes), number, replace=False).tolist())]
    halves = _tally(part, mode)
    if len(halves.clusters) < 2:
        return rows
    rows["two halves of real training"] = {
        metric: Number(value, low, high, None, number, len(halves.clusters))
        for metric, (value, low, high) in halves.floor(table).items()
    }
    return rows


def control_rows(samples: Tiles, asked: Tiles, bank: Tiles, rng: np.random.Generator) -> dict[str, Row]:
    """CCS, SPG and CSC of samples made at the counts of the ``asked`` tiles, beside retrieval, chance and a copy.

    An unconditional model knows the counts and nothing else: count-matched retrieval is what that is worth.
    """
    size = np.array([[len(s.lane_mask), len(s.agent_mask)] for s in bank.scenes])
    wanted = np.array([[len(s.lane_mask), len(s.agent_mask)] for s in asked.scenes])
    gap = np.abs(size[None] - wanted[:, None]).sum(-1)
    matched = [int(rng.choice(np.argsort(row, kind="stable")[:RETRIEVED])) for row in gap]
    populations = {
        "samples": samples.scenes,
        "count-matched training tiles": bank[matched].scenes,
        "random training tiles": bank[rng.integers(len(bank.scenes), size=len(asked.scenes)).tolist()].scenes,
        "copy": asked.scenes,
    }
    raw, clusters = describe(asked.scenes), len(set(asked.clusters))
    try:
        frame = ControlFrame.of(raw, asked.clusters, rng)
    except ValueError:  # too few locations to shuffle among: SPG is then not known
        frame = ControlFrame.of(raw, asked.clusters, rng, shuffles=0)
    return {
        name: {
            metric: Number(value, math.nan, math.nan, None, len(scenes), clusters)
            for metric, value in frame(describe(scenes)).items()
        }
        for name, scenes in populations.items()
    }


def _tally(tiles: Tiles, mode: Mode) -> Tally:
    tally = Tally()
    for scene, cluster in zip(tiles.scenes, tiles.clusters, strict=True):
        tally.add(scene_sums(scene, mode), cluster)
    return tally
