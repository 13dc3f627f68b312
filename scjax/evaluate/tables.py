"""Tables of a report: one row per method, every number with its bootstrap interval over location clusters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from scjax.evaluate.table_notes import NOTES
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
_COUNT_COLUMNS = {"lanes": 0, "agents": 17}  # of log(1 + count) in the global descriptor; agents without the ego

Stats = Mapping[str, SceneStats]
"""Title of a method -> statistics of its scenes."""
Rows = Mapping[str, Sequence[int]]
"""Title of a method -> row of the reference of every scene; empty without references."""


@dataclasses.dataclass(frozen=True)
class Number:
    """A value with its 95 % interval; NaN where unknown."""

    value: float
    low: float = NAN
    high: float = NAN


@dataclasses.dataclass(frozen=True)
class Row:
    """The numbers of one method, and how many scenes and clusters they come from."""

    numbers: dict[str, Number]
    scenes: int
    clusters: int


@dataclasses.dataclass
class Section:
    """A table.

    Attributes:
      title: what it shows.
      note: how to read it.
      rows: title of a method -> row.
      floor: values between two sets of real scenes, mean and central 95 %; empty where there is no floor.
    """

    title: str
    note: str
    rows: dict[str, Row]
    floor: dict[str, Number] = dataclasses.field(default_factory=dict)


def distribution_section(
    stats: Stats, real: SceneStats, retrieval_set: SceneStats | None, mode: Mode, *, draws: int = DRAWS
) -> Section:
    """Lane graphs and vehicles against ``real``; the floor comes from the retrieval set, or without one from
    ``real``."""

    def table(generated: Sums, reference: Sums) -> Values:
        return distribution_values(generated, reference, mode)

    rows = {name: _row(one, real, f"{mode}/", table, draws) for name, one in stats.items()}
    source = (retrieval_set if retrieval_set is not None else real).cluster_sums
    floor: dict[str, Number] = {}
    if len(source.clusters) > 1:
        ranges = _with_prefix(source, f"{mode}/").floor(table, scenes=len(real), splits=draws)
        floor = {name: Number(*numbers) for name, numbers in ranges.items()}
    title = {"strict": "Lane graphs and vehicles", "compat": "Lane graphs and vehicles, as the reference code counts"}
    return Section(title[mode], NOTES[mode], rows, floor)


def realism_section(stats: Stats, *, draws: int = DRAWS) -> Section:
    """Faults that single scenes show, without a reference."""
    rows = {name: _row(one, one, "scene/", lambda sums, _: scene_values(sums), draws) for name, one in stats.items()}
    return Section("Faults of single scenes", NOTES["faults"], rows)


def match_section(stats: Stats, *, draws: int = DRAWS) -> Section:
    """Agents against those of the reference; only methods that answer references."""

    def table(sums: Sums, _: Sums) -> Values:
        vehicles = match_values(sums, "match_vehicles")
        values = match_values(sums) | {f"{name} vehicles": vehicles[name] for name in ("M", "P", "PxR")}
        return values | {"M any class": match_values(sums, "match_any_class")["M"]}

    rows = {}
    for name, one in _with_references(stats).items():
        row = _row(one, one, "match", table, draws)
        precision = {key: Number(value) for key, value in precision_values(one).items()}
        rows[name] = dataclasses.replace(row, numbers=row.numbers | precision)
    return Section("Placement of agents", NOTES["match"], rows)


def control_section(stats: Stats, real: SceneStats, rows: Rows, *, seed: int = 0, draws: int = 200) -> Section:
    """Control metrics; only methods that answer references.

    SPG is unknown where most references lie at one location.
    """
    table_rows, frames = {}, {}
    for name, one in _with_references(stats).items():
        reference_rows = tuple(int(row) for row in rows[name])
        if not reference_rows:
            continue
        if reference_rows not in frames:
            frames[reference_rows] = _frame(real, reference_rows, seed)
        frame, locations = frames[reference_rows]
        values, bounds = frame(one.descriptors), frame.intervals(one.descriptors, locations, draws=draws)
        numbers = {key: Number(value, *bounds[key]) for key, value in values.items()}
        table_rows[name] = Row(numbers, len(one), len(set(locations)))
    return Section("Control", NOTES["control"], table_rows)


def gain_section(
    stats: Stats,
    real: SceneStats,
    rows: Rows,
    pairs: Sequence[Sequence[str]],
    *,
    seed: int = 0,
    draws: int = 200,
) -> Section:
    """Differences in control between two methods with the same references, with the interval of the difference.

    Args:
      pairs: (method, other method). If the other got shuffled conditions, the gain in CCS is SPG_prompt (metrics.md
        §4.4).

    Raises:
      ValueError: a method is missing, or the two answer different references.
    """
    answering, table_rows = _with_references(stats), {}
    for pair in pairs:
        if (
            len(pair) != 2
            or not set(pair) <= answering.keys()
            or list(rows[pair[0]]) != list(rows[pair[1]])
            or not len(rows[pair[0]])
        ):
            raise ValueError(
                f"gain {tuple(pair)!r}: give two methods that answer the same references, as ('prompt', "
                f"'nearest caption')"
            )
        own, other = pair
        frame, locations = _frame(real, tuple(int(row) for row in rows[own]), seed)
        descriptors = [answering[name].descriptors for name in pair]
        own_values, other_values = (frame(one) for one in descriptors)
        own_samples, other_samples = (frame.bootstrap_samples(one, locations, draws=draws) for one in descriptors)
        numbers = {}
        for key in own_values:
            if not key.endswith("SPG"):
                difference = own_samples[key] - other_samples[key] if own_samples else np.zeros(0)
                numbers[key] = Number(own_values[key] - other_values[key], *interval(difference))
        table_rows[f"{own} over {other}"] = Row(numbers, len(rows[own]), len(set(locations)))
    return Section("Gains in control", NOTES["gains"], table_rows)


def _frame(real: SceneStats, rows: tuple[int, ...], seed: int) -> tuple[ControlFrame, list[str]]:
    """The shared setting for methods that answer these references, and the locations of the references."""
    raw = Descriptor(*(x[list(rows)] for x in real.descriptors))
    locations = [real.clusters[row] for row in rows]
    return control_frame(raw, locations, seed), locations


def control_frame(raw: Descriptor, locations: Sequence[str], seed: int) -> ControlFrame:
    """A ``ControlFrame`` of references; without shuffles (hence SPG) where most lie at one location."""
    rng = np.random.default_rng(seed)
    try:
        return ControlFrame.of(raw, locations, rng)
    except ValueError:
        return ControlFrame.of(raw, locations, rng, shuffles=0)


def attribute_section(stats: Stats, *, draws: int = DRAWS) -> Section:
    """Which attributes of the reference the scenes show."""
    rows = {
        name: _row(one, one, "extra/", lambda sums, _: extra_values(sums), draws)
        for name, one in _with_references(stats).items()
        if any(key.startswith("extra/") for key in one.cluster_sums.total)
    }
    return Section("Attributes", NOTES["attributes"], rows)


def count_section(stats: Stats, real: SceneStats, rows: Rows) -> Section:
    """Numbers of lanes and agents against those of the reference."""
    table_rows = {}
    for name, one in _with_references(stats).items():
        reference_rows = [int(row) for row in rows[name]]
        numbers = {}
        for element, column in _COUNT_COLUMNS.items():
            true, generated = (np.rint(np.expm1(side.descriptors.glob[:, column])) for side in (real, one))
            errors = count_errors(true[reference_rows].astype(int), generated)
            numbers |= {f"{element} {key}": Number(value) for key, value in errors.items()}
        table_rows[name] = Row(numbers, len(one), len(set(one.clusters)))
    return Section("Numbers of lanes and agents", NOTES["counts"], table_rows)


def _row(one: SceneStats, real: SceneStats, prefix: str, table: Callable[[Sums, Sums], Values], draws: int) -> Row:
    generated, reference = _with_prefix(one.cluster_sums, prefix), _with_prefix(real.cluster_sums, prefix)
    clusters = len(one.cluster_sums.clusters)
    if not len(one) or not len(real):
        return Row({}, len(one), clusters)
    values = table(generated.total, reference.total)
    bounds = generated.intervals(reference, table, draws=draws)
    return Row({name: Number(value, *bounds[name]) for name, value in values.items()}, len(one), clusters)


def _with_prefix(cluster_sums: ClusterSums, prefix: str) -> ClusterSums:
    """The sums that one table needs: resampling fewer sums is cheaper."""
    return ClusterSums(
        {
            cluster: {name: value for name, value in sums.items() if name.startswith(prefix)}
            for cluster, sums in cluster_sums.clusters.items()
        }
    )


def _with_references(stats: Stats) -> dict[str, SceneStats]:
    return {name: one for name, one in stats.items() if one.detections}
