"""Measured populations -> tables: a row a population, every number with its interval over location clusters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from scjax.evaluate.notes import NOTES
from scjax.metrics.cluster_sums import DRAWS, ClusterSums
from scjax.metrics.control import ControlFrame
from scjax.metrics.counts import count_errors
from scjax.metrics.descriptors import Descriptor
from scjax.metrics.distributions import Sums
from scjax.metrics.measure import (
    distribution_values,
    extra_values,
    match_values,
    precision_values,
    scene_values,
)
from scjax.metrics.pooling import Values, interval
from scjax.metrics.scene_stats import SceneStats
from scjax.metrics.topology import Mode

NAN = math.nan
_COUNTS = {"lanes": 0, "agents": 17}  # places of log(1 + number) in the global descriptor; the ego is no agent there


@dataclasses.dataclass(frozen=True)
class Number:
    """A value with its 95 % interval; NaN where it is unknown."""

    value: float
    low: float = NAN
    high: float = NAN


@dataclasses.dataclass(frozen=True)
class Row:
    """Numbers of a population."""

    numbers: dict[str, Number]
    scenes: int
    clusters: int


@dataclasses.dataclass
class Section:
    """A table.

    Attributes:
      title, note: what it shows and how to read it.
      rows: population -> row.
      floor: what two sets of real scenes say of each other: mean and range of 95 %; empty where that means nothing.
    """

    title: str
    note: str
    rows: dict[str, Row]
    floor: dict[str, Number] = dataclasses.field(default_factory=dict)


def distribution_section(
    measured: Mapping[str, SceneStats], real: SceneStats, bank: SceneStats | None, mode: Mode, *, draws: int = DRAWS
) -> Section:
    """The published tables of lane graphs and vehicles, against ``real``; the floor comes from ``bank``, if any."""

    def table(generated: Sums, theirs: Sums) -> Values:
        return distribution_values(generated, theirs, mode)

    rows = {name: _row(one, real, f"{mode}/", table, draws) for name, one in measured.items()}
    source = bank if bank is not None else real
    floor: dict[str, Number] = {}
    if len(source.cluster_sums.clusters) > 1:
        found = _only(source.cluster_sums, f"{mode}/").floor(table, scenes=len(real), splits=draws)
        floor = {name: Number(*numbers) for name, numbers in found.items()}
    kind = {"strict": "Lane graphs and vehicles", "compat": "The same as the reference code counts"}[mode]
    return Section(kind, NOTES[mode], rows, floor)


def fault_section(measured: Mapping[str, SceneStats], *, draws: int = DRAWS) -> Section:
    """What scenes show by themselves to be wrong."""
    rows = {name: _row(one, one, "scene/", lambda sums, _: scene_values(sums), draws) for name, one in measured.items()}
    return Section("Faults of single scenes", NOTES["faults"], rows)


def match_section(measured: Mapping[str, SceneStats], *, draws: int = DRAWS) -> Section:
    """Agents against those of the reference; populations without references are left out."""

    def table(sums: Sums, _: Sums) -> Values:
        vehicles = match_values(sums, "match_vehicles")
        found = match_values(sums) | {f"{name} vehicles": vehicles[name] for name in ("M", "P", "PxR")}
        return found | {"M any class": match_values(sums, "match_any_class")["M"]}

    rows = {}
    for name, one in _paired(measured).items():
        row = _row(one, one, "match", table, draws)
        precision = {key: Number(value) for key, value in precision_values(one).items()}
        rows[name] = dataclasses.replace(row, numbers=row.numbers | precision)
    return Section("Placement of agents", NOTES["match"], rows)


def control_section(
    measured: Mapping[str, SceneStats],
    real: SceneStats,
    rows: Mapping[str, Sequence[int]],
    *,
    seed: int = 0,
    draws: int = 200,
) -> Section:
    """Adherence to the reference; ``rows``: population -> reference of every scene, where there are any.

    A population whose references lie at one place for the most part has no SPG.
    """
    made, frames = {}, {}
    for name, one in _paired(measured).items():
        chosen = tuple(int(row) for row in rows[name])
        if not chosen:
            continue
        if chosen not in frames:
            frames[chosen] = _framed(real, chosen, seed)
        frame, places = frames[chosen]
        values, bounds = frame(one.descriptors), frame.intervals(one.descriptors, places, draws=draws)
        numbers = {key: Number(value, *bounds[key]) for key, value in values.items()}
        made[name] = Row(numbers, len(one), len(set(places)))
    return Section("Control", NOTES["control"], made)


def gain_section(
    measured: Mapping[str, SceneStats],
    real: SceneStats,
    rows: Mapping[str, Sequence[int]],
    pairs: Sequence[str],
    *,
    seed: int = 0,
    draws: int = 200,
) -> Section:
    """How much more control one population shows than another made for the same references; the interval is that of
    the difference.

    Args:
      pairs: "ROW|OTHER". Where OTHER was made from another's condition, the gain in CCS is SPG_prompt (metrics.md
        §4.4).

    Raises:
      ValueError: no such rows, or rows made for different references.
    """
    answering, made = _paired(measured), {}
    for pair in filter(None, pairs):
        own, _, other = pair.partition("|")
        if not {own, other} <= answering.keys() or list(rows[own]) != list(rows[other]) or not len(rows[own]):
            raise ValueError(
                f"gain {pair!r}: write two rows that answer the same references, as prompt|nearest caption"
            )
        frame, places = _framed(real, tuple(int(row) for row in rows[own]), seed)
        sides = [answering[name].descriptors for name in (own, other)]
        values, less = (frame(side) for side in sides)
        bootstrap_samples, without = (frame.bootstrap_samples(side, places, draws=draws) for side in sides)
        numbers = {
            key: Number(
                values[key] - less[key],
                *interval(bootstrap_samples[key] - without[key] if bootstrap_samples else np.zeros(0)),
            )
            for key in values
            if not key.endswith("SPG")
        }
        made[f"{own} over {other}"] = Row(numbers, len(rows[own]), len(set(places)))
    return Section("Gains in control", NOTES["gains"], made)


def _framed(real: SceneStats, chosen: tuple[int, ...], seed: int) -> tuple[ControlFrame, list[str]]:
    """What populations made for these references are compared by, and where those lie."""
    raw = Descriptor(*(x[list(chosen)] for x in real.descriptors))
    places = [real.clusters[row] for row in chosen]
    return control_frame(raw, places, seed), places


def control_frame(raw: Descriptor, places: Sequence[str], seed: int) -> ControlFrame:
    """Of references; without shuffles, hence SPG, where most of them lie at one place."""
    rng = np.random.default_rng(seed)
    try:
        return ControlFrame.of(raw, places, rng)
    except ValueError:
        return ControlFrame.of(raw, places, rng, shuffles=0)


def caption_section(measured: Mapping[str, SceneStats], *, draws: int = DRAWS) -> Section:
    """Which facts of the reference's caption the scenes show."""
    rows = {
        name: _row(one, one, "extra/", lambda sums, _: extra_values(sums), draws)
        for name, one in _paired(measured).items()
        if any(key.startswith("extra/") for key in one.cluster_sums.total)
    }
    return Section("Facts of the captions", NOTES["captions"], rows)


def count_section(measured: Mapping[str, SceneStats], real: SceneStats, rows: Mapping[str, Sequence[int]]) -> Section:
    """Numbers of lanes and agents against the reference's."""
    made = {}
    for name, one in _paired(measured).items():
        chosen = [int(row) for row in rows[name]]
        numbers = {}
        for kind, column in _COUNTS.items():
            true, found = (np.rint(np.expm1(side.descriptors.glob[:, column])) for side in (real, one))
            errors = count_errors(true[chosen].astype(int), found)
            numbers |= {f"{kind} {key}": Number(value) for key, value in errors.items()}
        made[name] = Row(numbers, len(one), len(set(one.clusters)))
    return Section("Numbers of lanes and agents", NOTES["counts"], made)


def _row(one: SceneStats, real: SceneStats, prefix: str, table: Callable[[Sums, Sums], Values], draws: int) -> Row:
    ours, theirs = _only(one.cluster_sums, prefix), _only(real.cluster_sums, prefix)
    if not len(one) or not len(real):
        return Row({}, len(one), len(one.cluster_sums.clusters))
    values, bounds = table(ours.total, theirs.total), ours.intervals(theirs, table, draws=draws)
    numbers = {name: Number(value, *bounds[name]) for name, value in values.items()}
    return Row(numbers, len(one), len(one.cluster_sums.clusters))


def _only(cluster_sums: ClusterSums, prefix: str) -> ClusterSums:
    """What one table needs: resampling is then cheap."""
    return ClusterSums(
        {
            cluster: {name: value for name, value in sums.items() if name.startswith(prefix)}
            for cluster, sums in cluster_sums.clusters.items()
        }
    )


def _paired(measured: Mapping[str, SceneStats]) -> dict[str, SceneStats]:
    return {name: one for name, one in measured.items() if one.detections}
