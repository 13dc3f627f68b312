"""Populations: the scenes of one method with their references; measured in parts, in any number of processes.

Measured parts are files whose names are hashes of everything they depend on. An interrupted run continues there, and
unchanged methods are not measured again.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import itertools
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from scjax.evaluate.hashing import content_hash, row_text
from scjax.evaluate.sources import SceneSource
from scjax.language.attributes.draw import full_request
from scjax.language.attributes.table import GROUPS, measure_attributes, score_attributes
from scjax.metrics.measure import measure
from scjax.metrics.placement import field_of_view
from scjax.metrics.pooling import Ratios
from scjax.metrics.scene_stats import SceneStats, merge_stats
from scjax.scene import Scene

PART_SIZE = 250  # scenes per measured part
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
FORMAT = 5  # of measured parts; raise it when their content changes


@dataclasses.dataclass(frozen=True)
class Population:
    """The scenes of one method.

    Attributes:
      name: title in tables.
      source: the scenes.
      references: source of the conditions; None for scenes without references.
      rows: row of the reference of every scene.
      siblings: further samples for the same conditions, in the same order.
      field_of_view: half angle [degrees] and distance ahead [m] of the camera in whose view agents are matched; None:
        everywhere.
      attributes: whether to compare the attributes of scene and reference.
    """

    name: str
    source: SceneSource
    references: SceneSource | None = None
    rows: Sequence[int] = ()
    siblings: tuple[SceneSource, ...] = ()
    field_of_view: tuple[float, float] | None = None
    attributes: bool = False

    def __len__(self) -> int:
        return len(self.source.clusters)

    @property
    def fingerprint(self) -> str:
        """A hash of everything that its numbers depend on, except the code."""
        references = "" if self.references is None else self.references.fingerprint
        siblings = [sibling.fingerprint for sibling in self.siblings]
        options = (str(FORMAT), str(self.field_of_view), str(self.attributes))
        return content_hash(self.source.fingerprint, references, row_text(self.rows), *options, *siblings)

    def clusters(self, start: int, stop: int) -> list[str]:
        """Locations of scenes start..stop: those of their references, if there are any."""
        if self.references is None:
            return self.source.clusters[start:stop]
        every = self.references.clusters
        return [every[int(row)] for row in self.rows[start:stop]]


def measure_populations(
    populations: Sequence[Population],
    folder: Path,
    *,
    workers: int = 1,
    shard: tuple[int, int] = (0, 1),
    part_size: int = PART_SIZE,
) -> list[SceneStats] | None:
    """Statistics of all populations; None while parts of other shards are missing.

    Args:
      folder: for measured parts.
      workers: number of processes; 0: this one.
      shard: (i, n): measure every n-th part, starting at the i-th.
      part_size: scenes per part.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = [_parts(population, folder, part_size) for population in populations]
    own = [part for k, part in enumerate(itertools.chain(*parts)) if k % shard[1] == shard[0]]
    missing = [part for part in own if not part.path.exists()]
    pause = 0.5 if sys.stderr.isatty() else 30.0
    with (
        tqdm(total=len(missing), desc="measuring", unit=f"x{part_size} scenes", mininterval=pause) as bar,
        _pool(workers) as pool,
    ):
        for _ in (pool.map if pool else map)(_measure_part, missing):
            bar.update()
    if not all(part.path.exists() for part in itertools.chain(*parts)):
        return None
    return [merge_stats([SceneStats.load(part.path) for part in of_population]) for of_population in parts]


class _Part(NamedTuple):
    """Scenes start..stop of a population, and the file of their statistics."""

    population: Population
    start: int
    stop: int
    path: Path


def _parts(population: Population, folder: Path, size: int) -> list[_Part]:
    name = content_hash(population.fingerprint, str(size))
    return [
        _Part(population, start, min(start + size, len(population)), folder / f"{name}-{start // size:05d}.npz")
        for start in range(0, len(population), size)
    ]


def _measure_part(part: _Part) -> None:
    population, start, stop, path = part
    rows, references = range(start, stop), None
    if population.references is not None:
        references = population.references.read([int(row) for row in population.rows[start:stop]])
    siblings = None
    if population.siblings:
        siblings = list(zip(*(source.read(rows) for source in population.siblings), strict=True))
    stats = measure(
        population.source.read(rows),
        population.clusters(start, stop),
        references,
        siblings=siblings,
        ego=population.source.ego,
        region=None if population.field_of_view is None else field_of_view(*population.field_of_view),
        extra_ratios=_attribute_ratios if population.attributes else None,
    )
    stats.save(path)


def _attribute_ratios(scene: Scene, reference: Scene | None) -> Ratios:
    """Group of attributes -> (attributes of the reference that the scene shows, attributes of the reference)."""
    if reference is None:
        return {}
    request = full_request(measure_attributes(reference))
    shown = request.keys() - score_attributes(scene, request).misses.keys()
    of_groups = {group: request.keys() & {item.name for item in items} for group, items in GROUPS.items()}
    return {group: (float(len(names & shown)), float(len(names))) for group, names in of_groups.items()}


@contextlib.contextmanager
def single_threaded_children() -> Iterator[None]:
    """Child processes started inside use one thread for linear algebra: more are slower on small arrays."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


@contextlib.contextmanager
def _pool(workers: int) -> Iterator[concurrent.futures.Executor | None]:
    if not workers:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    with single_threaded_children(), concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield pool
