"""Builds the populations of a report from ``MethodSpec``s; all of them answer the same references."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from scjax.evaluate.corruption import LADDER, Corrupted
from scjax.evaluate.generated import (
    PART_SIZE,
    ModelFunctions,
    PartFiles,
    SamplingOptions,
    Shard,
    generate_reconstructions,
    generate_samples,
)
from scjax.evaluate.lane_aligned import LaneAligned
from scjax.evaluate.method_spec import COPY, IN_ORDER, RANDOM_ON_LANES, RECONSTRUCTION, MethodSpec
from scjax.evaluate.population import Population
from scjax.evaluate.requests import request_function
from scjax.evaluate.retrieval import Index, retrieve
from scjax.evaluate.sources import ChosenRows, SceneSource, open_source
from scjax.generate.model import Model

_LADDER_BASE = "other scene, same counts"  # the scenes that fill what a rung of the ladder does not keep
_SEED_STEP = 1000  # between the seeds of repeated retrievals


@dataclasses.dataclass
class MethodBuilder:
    """Builds populations; models and retrieval indices are loaded once.

    Attributes:
      reference: scenes that the methods answer.
      retrieval_set: training scenes for retrieval; None without any.
      count: scenes per method; references repeat in turn.
      folder: where generated scenes are stored.
      options: how models sample, unless a method says otherwise.
      consensus: samples per condition including the row itself; 1: no siblings.
      field_of_view: see ``Population``.
      attributes: see ``Population``.
      shard, part_size: see ``PartFiles``.
      functions: of scjax.generate.
      models: folder -> loaded model.
    """

    reference: SceneSource
    retrieval_set: SceneSource | None
    count: int
    folder: Path
    options: SamplingOptions = dataclasses.field(default_factory=SamplingOptions)
    consensus: int = 1
    field_of_view: tuple[float, float] | None = None
    attributes: bool = False
    shard: Shard = (0, 1)
    part_size: int = PART_SIZE
    functions: ModelFunctions = dataclasses.field(default_factory=ModelFunctions)
    models: dict[str, Model] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def rows(self) -> list[int]:
        """Row of the reference of every scene of a method."""
        return (np.arange(self.count) % len(self.reference.clusters)).tolist()

    def population(self, spec: MethodSpec) -> Population:
        """The population of a method; generates its scenes where they are missing.

        Raises:
          ValueError: a baseline needs a retrieval set, or scenes do not fit the references.
          OtherShardsPending: other shards have not generated their parts yet.
        """
        samples = range(self.consensus if spec.is_random else 1)
        first, *siblings = (self._source(spec, sample) for sample in samples)
        if not spec.answers_references:
            return Population(spec.title, first)
        return Population(
            spec.title,
            first,
            self.reference,
            self.rows,
            tuple(siblings),
            field_of_view=self.field_of_view,
            attributes=self.attributes and spec.best_of == 1,  # what chose scenes does not judge them
        )

    def model(self, folder: str) -> Model:
        """A model, loaded once."""
        if folder not in self.models:
            self.models[folder] = self.functions.load(folder)
        return self.models[folder]

    def _source(self, spec: MethodSpec, sample: int) -> SceneSource:
        """The scenes of a method; ``sample`` counts siblings."""
        if spec.model:
            return self._generated(spec, sample)
        seed = self.options.seed + sample
        return self._baseline(spec, seed) if spec.baseline else self._from_disk(spec, seed)

    def _from_disk(self, spec: MethodSpec, seed: int) -> SceneSource:
        source = open_source(spec.source)
        if spec.pairing == IN_ORDER and len(source.clusters) != self.count:
            raise ValueError(
                f"method {spec.name!r}: {len(source.clusters)} scenes but {self.count} references: {IN_ORDER} "
                f"pairs them"
            )
        return source if spec.pairing in ("", IN_ORDER) else self._retrieved(source, spec.pairing, seed)

    def _baseline(self, spec: MethodSpec, seed: int) -> SceneSource:
        copies = ChosenRows(self.reference, self.rows)
        if spec.baseline == COPY:
            return copies
        if self.retrieval_set is None:
            raise ValueError(
                f"the baseline {spec.name!r} needs a retrieval set: name one with --config.retrieval_set=..."
            )
        if spec.baseline == RANDOM_ON_LANES:
            return LaneAligned(copies, self.retrieval_set, seed)
        if spec.baseline in LADDER:
            return Corrupted(
                copies, self._retrieved(self.retrieval_set, _LADDER_BASE, seed), *LADDER[spec.baseline], seed
            )
        return self._retrieved(self.retrieval_set, spec.baseline, seed)

    def _retrieved(self, retrieval_set: SceneSource, rule: str, seed: int) -> SceneSource:
        """``count`` rows of the retrieval set; where references repeat, each turn retrieves with another seed."""
        captions = "caption" in rule
        queries, candidates = (self._index(source, captions) for source in (self.reference, retrieval_set))
        rows = retrieve(rule, queries, candidates, seed=seed, progress=False)
        if self.count > len(rows):
            turns = range(-(-self.count // len(self.reference.clusters)))
            seeds = [seed + _SEED_STEP * turn for turn in turns]
            rows = np.concatenate([retrieve(rule, queries, candidates, seed=s, progress=False) for s in seeds])
        return ChosenRows(retrieval_set, rows[: self.count])

    def _index(self, source: SceneSource, captions: bool) -> Index:
        index = self._indices.get(source.fingerprint)
        if index is None or (captions and not index.captions):
            index = self._indices[source.fingerprint] = Index.of(source, captions=captions)
        return index

    @functools.cached_property
    def _indices(self) -> dict[str, Index]:
        return {}

    def _generated(self, spec: MethodSpec, sample: int) -> SceneSource:
        model = self.model(spec.model)
        title = spec.name if spec.request == RECONSTRUCTION else f"{spec.name} ({spec.request})"
        folder = self.folder / _file_name(spec.name, sample)
        files = PartFiles(folder, self.reference, self.rows, title, self.shard, self.part_size)
        if spec.request == RECONSTRUCTION:
            scenes = generate_reconstructions(model, files, self.functions.reconstruct)
            scenes.reconstructed_by = spec.model
            return scenes
        options = dataclasses.replace(
            self.options,
            seed=self.options.seed + sample,
            energy_guidance=spec.energy_guidance,
            best_of=spec.best_of,
        )
        request = request_function(model, self.reference, spec.request)
        return generate_samples(model, files, request, options, self.functions.sample)


def _file_name(name: str, sample: int) -> str:
    safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in name)
    return f"{safe}-{sample}" if sample else safe
