"""A row of the tables: scenes, the references they were made for; measured part by part, in any number of processes.

Parts that are measured stay in files under a name that changes with everything they depend on: a run that was stopped
goes on where it was, and rows that did not change are not measured again.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from tqdm import tqdm

from scjax.evaluate.sources import Source, digest, row_text
from scjax.language.agreement import fact_agreement
from scjax.language.facts import extract_facts
from scjax.metrics.measure import measure
from scjax.metrics.placement import field_of_view
from scjax.metrics.pooling import Ratios
from scjax.metrics.scene_stats import SceneStats, merge_stats
from scjax.scene import Scene

PART = 250  # scenes
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
FORMAT = 3  # of the measured parts; to be raised when what they hold changes


@dataclasses.dataclass(frozen=True)
class Population:
    """Scenes under a name.

    Attributes:
      references: source that conditions came from; None for scenes that stand for themselves.
      rows: reference of every scene.
      siblings: other samples of the same conditions, in the same order.
      wedge: half angle [degrees] and distance ahead [m] of the camera in whose view agents are compared; None: all.
      facts: whether captions of scene and reference are compared.
    """

    name: str
    source: Source
    references: Source | None = None
    rows: Sequence[int] = ()
    siblings: tuple[Source, ...] = ()
    wedge: tuple[float, float] | None = None
    facts: bool = False

    def __len__(self) -> int:
        return len(self.source.clusters)

    @property
    def fingerprint(self) -> str:
        """Of everything that its numbers depend on, but the code."""
        references = "" if self.references is None else self.references.fingerprint
        siblings = [sibling.fingerprint for sibling in self.siblings]
        options = (str(FORMAT), str(self.wedge), str(self.facts))
        return digest(self.source.fingerprint, references, row_text(self.rows), *options, *siblings)

    def clusters(self, start: int, stop: int) -> list[str]:
        """Location of scenes: that of their references, where there are any."""
        if self.references is None:
            return self.source.clusters[start:stop]
        every = self.references.clusters
        return [every[int(row)] for row in self.rows[start:stop]]


def measured(
    populations: Sequence[Population], folder: Path, *, workers: int = 1, shard: tuple[int, int] = (0, 1)
) -> list[SceneStats] | None:
    """All populations, or None where other shards have not done their parts yet.

    Args:
      folder: of the measured parts.
      workers: processes here; 0 measures in this one.
      shard: (i, n): this call measures every n-th part, from the i-th on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    parts = [(population, start) for population in populations for start in range(0, len(population), PART)]
    todo = [(p, start) for k, (p, start) in enumerate(parts) if k % shard[1] == shard[0]]
    todo = [(p, start) for p, start in todo if not _path(folder, p, start).exists()]
    pause = 0.5 if sys.stderr.isatty() else 30.0
    with (
        tqdm(total=len(todo), desc="measuring", unit=f"x{PART} scenes", mininterval=pause) as bar,
        _pool(workers) as pool,
    ):
        jobs = [(folder, p, start) for p, start in todo]
        for _ in pool.map(_measure_part, *zip(*jobs, strict=True)) if pool and jobs else _here(jobs):
            bar.update()
    if not all(_path(folder, p, start).exists() for p, start in parts):
        return None
    return [
        merge_stats([SceneStats.load(_path(folder, p, start)) for start in range(0, len(p), PART)]) for p in populations
    ]


def _measure_part(folder: Path, population: Population, start: int) -> None:
    stop = min(start + PART, len(population))
    rows, references = range(start, stop), None
    if population.references is not None:
        references = population.references.read([int(row) for row in population.rows[start:stop]])
    siblings = None
    if population.siblings:
        siblings = list(zip(*(source.read(rows) for source in population.siblings), strict=True))
    found = measure(
        population.source.read(rows),
        population.clusters(start, stop),
        references,
        siblings=siblings,
        ego=population.source.ego,
        region=None if population.wedge is None else field_of_view(*population.wedge),
        extra_ratios=_facts if population.facts else None,
    )
    found.save(_path(folder, population, start))


def _facts(scene: Scene, reference: Scene | None) -> Ratios:
    return {} if reference is None else fact_agreement(extract_facts(reference), extract_facts(scene))


def _path(folder: Path, population: Population, start: int) -> Path:
    return folder / f"{population.fingerprint}-{start // PART:05d}.npz"


def _here(jobs: Sequence[tuple[Path, Population, int]]) -> Iterator[None]:
    for job in jobs:
        yield _measure_part(*job)


@contextlib.contextmanager
def one_thread_each() -> Iterator[None]:
    """Processes started within use one thread for linear algebra: on small arrays more only wait for each other."""
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
    with one_thread_each(), concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield pool
