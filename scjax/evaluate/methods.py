"""The rows of a report, from their texts in the config (``RowText``): populations that answer the same references."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from scjax.evaluate.corruption import LADDER, Corrupted
from scjax.evaluate.generated import Ask, Sampling, Shard, counts_of, decoded, lanes_of, nothing_of, prompt_of, sampled
from scjax.evaluate.lane_aligned import LaneAligned
from scjax.evaluate.population import Population
from scjax.evaluate.retrieval import RULES, Index, retrieve
from scjax.evaluate.sources import Chosen, Source, open_source
from scjax.generate.conditions import Condition
from scjax.generate.model import Model, load_model
from scjax.scene import Scene

DECODED, DRAWN = "decoded", "drawn"
REQUESTS = {"counts": counts_of, "lanes": lanes_of, DRAWN: nothing_of, "prompt": prompt_of}
OTHER = "other prompt"
ASKED = (*REQUESTS, "prompt+counts", f"{OTHER}+counts")
WAYS = {"guided": {"energy_guidance": True}, "unguided": {"energy_guidance": False}, "picked": {"picked": True}}
"""What a row may say behind the ?, as fields of ``Sampling``."""
IN_ORDER = "inorder"
BASELINES = (*RULES, *LADDER, "random on lanes", "copy")
_UNDER = "other scene, same counts"  # of which the ladder is made


@dataclasses.dataclass(frozen=True)
class RowText:
    """What a row's text says.

    NAME=records:...            scenes of a source (also npz:, tiles:); they answer no reference
    NAME=SOURCE?inorder         the same, the first made for the first reference, and so on
    NAME=SOURCE?RULE            for each reference the scene of a source that a rule of retrieval finds
    NAME=model:FOLDER#counts    made by a model at each reference's numbers of lanes and agents
    NAME=model:FOLDER#lanes     traffic on each reference's own lanes
    NAME=model:FOLDER#prompt    made from a caption of each reference; prompt+counts: at its numbers of lanes and agents
    NAME=model:FOLDER#other prompt+counts   from the caption of a reference of another location, at each one's numbers
    NAME=model:FOLDER#drawn     made without any request; they answer no reference
    NAME=model:FOLDER#counts?steered, or ?unsteered, with any request: whatever the model has by default
    NAME=model:FOLDER#prompt?picked, also #prompt+counts: the best of several, tidied, as scjax generate hands out
    NAME=model:FOLDER#decoded   each reference as the autoencoder decodes it
    NAME                        a baseline: a rule of retrieval in the bank, C1, C2, C3, random on lanes, copy

    Attributes:
      place: the source, or the model's folder; "" for a baseline.
      how: the rule of retrieval, what the model is asked, or the baseline.
      of_model: whether a model makes it.
      way: one of ``WAYS`` to sample; "": as the model does by default.
    """

    name: str
    place: str
    how: str
    of_model: bool = False
    way: str = ""

    @classmethod
    def parse(cls, text: str) -> RowText:
        """Raises ValueError where the text means nothing."""
        name, equals, spec = text.partition("=")
        if not equals:
            if name not in BASELINES:
                raise ValueError(f"row {text!r}: write NAME=SOURCE, or one of the baselines {', '.join(BASELINES)}")
            return cls(name, "", name)
        if not spec.startswith("model:"):
            place, _, rule = spec.partition("?")
            return cls(name, place, rule)
        folder, _, request = spec.removeprefix("model:").partition("#")
        asked, _, way = request.partition("?")
        if asked not in (*ASKED, DECODED):
            raise ValueError(f"row {name!r}: write what is asked behind the #: {', '.join((*ASKED, DECODED))}")
        if way and way not in WAYS:
            *others, last = WAYS
            raise ValueError(f"row {name!r}: behind the ?, write {', '.join(others)} or {last}, not {way!r}")
        if way and asked == DECODED:
            raise ValueError(f"row {name!r}: decoded scenes are not sampled, so that there is nothing to steer")
        if way == "picked" and "prompt" not in asked:
            raise ValueError(f"row {name!r}: scenes are picked by what their prompt asks for, and {asked} is none")
        return cls(name, folder, asked, of_model=True, way=way)

    @property
    def answers(self) -> bool:
        """Whether its scenes were made, or found, for the references."""
        return self.how not in ("", DRAWN)

    @property
    def random(self) -> bool:
        """Whether another seed gives other scenes."""
        return self.how in RULES or (self.of_model and self.how not in (DECODED, DRAWN))


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
    shard: Shard = (0, 1)
    models: dict[str, Model] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def rows(self) -> list[int]:
        """Reference of every scene of a row."""
        return (np.arange(self.count) % len(self.reference.clusters)).tolist()

    def population(self, text: str) -> Population:
        """A row of the report.

        Raises:
          ValueError: a text that means nothing, or a baseline that needs a bank without one.
          Pending: other shards have not made their parts yet.
        """
        row = RowText.parse(text)
        first, *siblings = (self._source(row, draw) for draw in range(self.consensus if row.random else 1))
        if not row.answers:
            return Population(row.name, first)
        return Population(
            row.name, first, self.reference, self.rows, tuple(siblings), wedge=self.wedge, facts=self.facts
        )

    def model(self, folder: str) -> Model:
        """A model, loaded once."""
        if folder not in self.models:
            self.models[folder] = load_model(folder)
        return self.models[folder]

    def _source(self, row: RowText, draw: int) -> Source:
        name, seed = row.name, self.sampling.seed + draw
        if row.of_model:
            return self._made(row, draw)
        if row.place:
            source = open_source(row.place)
            if row.how == IN_ORDER and len(source.clusters) != self.count:
                raise ValueError(
                    f"row {name!r}: {len(source.clusters)} scenes but {self.count} references: {IN_ORDER} pairs them"
                )
            return source if row.how in ("", IN_ORDER) else self._retrieved(source, row.how, seed)
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

    def _made(self, row: RowText, draw: int) -> Source:
        model, place = self.model(row.place), self.folder / _file_name(row.name, draw)
        if row.how == DECODED:
            made = decoded(model, place, self.reference, self.rows, row.name, self.shard)
            made.decoded_by = row.place
            return made
        how = dataclasses.replace(self.sampling, seed=self.sampling.seed + draw, **WAYS.get(row.way, {}))
        title = f"{row.name} ({row.how})"
        return sampled(model, place, self.reference, self.rows, self._ask(model, row.how), how, title, self.shard)

    def _ask(self, model: Model, how: str) -> Ask:
        what, _, counts = how.partition("+")
        request = prompt_of if what == OTHER else REQUESTS[what]
        domains = getattr(self.reference, "domains", ())

        def ask(scene: Scene, row: int) -> Condition:
            index = int(scene.domain)
            domain = domains[index] if index < len(domains) else None
            told = self.reference.read([self._elsewhere(row)])[0] if what == OTHER else scene
            asked = request(model, told, domain)
            same = counts_of(model, scene, domain)
            return dataclasses.replace(asked, num_lanes=same.num_lanes, num_agents=same.num_agents) if counts else asked

        return ask

    def _elsewhere(self, row: int) -> int:
        """The next reference, in a circle, that lies at another location."""
        clusters = self.reference.clusters
        others = (*range(row + 1, len(clusters)), *range(row))
        found = next((other for other in others if clusters[other] != clusters[row]), None)
        if found is None:
            raise ValueError(f"all references lie at {clusters[row]}: there is no other location's prompt to give")
        return found


def _file_name(name: str, draw: int) -> str:
    safe = "".join(c if c.isalnum() or c in "-_" else "-" for c in name)
    return f"{safe}-{draw}" if draw else safe
