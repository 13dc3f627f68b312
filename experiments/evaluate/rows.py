"""The rows of a report, from their texts in the config: populations that all answer the same references.

NAME=records:..., npz:..., tiles:...   those scenes, one for each reference in turn where there are as many
NAME=SOURCE?RULE                       for each reference the scene of SOURCE that a rule of retrieval finds
NAME=model:FOLDER#ASK                  made by a model, asked for the reference's counts, its lanes, or decoded
NAME                                   a baseline: a rule of retrieval in the bank, C1, C2, C3, random on lanes, copy
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from experiments.evaluate.corruption import LADDER, Corrupted
from experiments.evaluate.lane_aligned import LaneAligned
from experiments.evaluate.made import Ask, Sampling, counts_of, decoded, lanes_of, nothing_of, sampled
from experiments.evaluate.population import Population
from experiments.evaluate.retrieval import RULES, Index, retrieve
from experiments.evaluate.sources import Chosen, Source, open_source
from scjax.model import Model, load

ASKED = {"counts": counts_of, "lanes": lanes_of, "drawn": nothing_of}
DECODED = "decoded"
IN_ORDER = "inorder"
BASELINES = (*RULES, *LADDER, "random on lanes", "copy")
_UNDER = "other scene, same counts"  # of which the ladder is made


@dataclasses.dataclass
class Rows:
    """Builds rows; what several of them need is read once.

    Attributes:
      reference: scenes that rows answer.
      bank: training scenes for retrieval; None if there are none.
      count: scenes of a row; references take turns.
      folder: where made scenes go.
      consensus: samples of a condition, the row itself included; 1 for no siblings.
    """

    reference: Source
    bank: Source | None
    count: int
    folder: Path
    sampling: Sampling = dataclasses.field(default_factory=Sampling)
    consensus: int = 1
    wedge: tuple[float, float] | None = None
    facts: bool = False
    models: dict[str, Model] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def rows(self) -> list[int]:
        """Reference of every scene of a row."""
        return (np.arange(self.count) % len(self.reference.clusters)).tolist()

    def population(self, text: str) -> Population:
        """A row of the report.

        Raises:
          ValueError: a text that means nothing, or a baseline that needs a bank without one.
        """
        name, equals, spec = text.partition("=")
        if not equals and name not in BASELINES:
            raise ValueError(f"row {text!r}: write NAME=SOURCE, or one of the baselines {', '.join(BASELINES)}")
        sources = [self._source(name, spec, draw) for draw in range(self._draws(name, spec))]
        first, *siblings = (source for source in sources if source is not None)
        if spec and "?" not in spec and (not spec.startswith("model:") or spec.endswith("#drawn")):
            return Population(name, first)
        return Population(name, first, self.reference, self.rows, tuple(siblings), wedge=self.wedge, facts=self.facts)

    def model(self, folder: str) -> Model:
        """A model, loaded once."""
        if folder not in self.models:
            self.models[folder] = load(folder)
        return self.models[folder]

    def _draws(self, name: str, spec: str) -> int:
        if spec.startswith("model:"):
            return 1 if spec.endswith(("#decoded", "#drawn")) else self.consensus
        random = spec.partition("?")[2] in RULES if spec else name in RULES
        return self.consensus if random else 1

    def _source(self, name: str, spec: str, draw: int) -> Source:
        seed = self.sampling.seed + draw
        if spec.startswith("model:"):
            return self._made(name, spec, draw)
        if spec:
            place, _, rule = spec.partition("?")
            source = open_source(place)
            if rule == IN_ORDER and len(source.clusters) != self.count:
                raise ValueError(
                    f"row {name!r}: {len(source.clusters)} scenes but {self.count} references: {IN_ORDER} pairs them"
                )
            return source if rule in ("", IN_ORDER) else self._retrieved(source, rule, seed)
        if name == "copy":
            return Chosen(self.reference, self.rows)
        if self.bank is None:
            raise ValueError(f"the baseline {name!r} finds its scenes in a bank: name one with --config.bank=...")
        if name == "random on lanes":
            return LaneAligned(Chosen(self.reference, self.rows), self.bank, seed)
        if name in LADDER:
            under = self._retrieved(self.bank, _UNDER, seed)
            return Corrupted(Chosen(self.reference, self.rows), under, *LADDER[name], seed)
        return self._retrieved(self.bank, name, seed)

    def _retrieved(self, bank: Source, rule: str, seed: int) -> Source:
        captions = "caption" in rule
        wanted, held = (self._index(source, captions) for source in (self.reference, bank))
        found = retrieve(rule, wanted, held, seed=seed, progress=False)
        if self.count <= len(found):
            return Chosen(bank, found[: self.count])
        turns = [retrieve(rule, wanted, held, seed=seed + 1000 * k, progress=False) for k in range(self._turns)]
        return Chosen(bank, np.concatenate(turns)[: self.count])

    @property
    def _turns(self) -> int:
        return -(-self.count // len(self.reference.clusters))

    def _index(self, source: Source, captions: bool) -> Index:
        held = self._indices.get(source.fingerprint)
        if held is None or (captions and not held.captions):
            held = self._indices[source.fingerprint] = Index.of(source, captions=captions)
        return held

    @functools.cached_property
    def _indices(self) -> dict[str, Index]:
        return {}

    def _made(self, name: str, spec: str, draw: int) -> Source:
        folder, _, asked = spec.removeprefix("model:").partition("#")
        if asked not in (*ASKED, DECODED):
            raise ValueError(f"row {name!r}: write what is asked behind the #: {', '.join((*ASKED, DECODED))}")
        model, place = self.model(folder), self.folder / _file_name(name, draw)
        if asked == DECODED:
            made = decoded(model, place, self.reference, self.rows, name)
            made.decoded_by = folder
            return made
        ask = self._ask(model, ASKED[asked])
        how = dataclasses.replace(self.sampling, seed=self.sampling.seed + draw)
        return sampled(model, place, self.reference, self.rows, ask, how, f"{name} ({asked})")

    def _ask(self, model: Model, request) -> Ask:
        domains = getattr(self.reference, "domains", ())

        def ask(scene, row):
            index = int(scene.domain)
            return request(model, scene, domains[index] if index < len(domains) else None)

        return ask


def _file_name(name: str, draw: int) -> str:
    safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in name)
    return f"{safe}-{draw}" if draw else safe
