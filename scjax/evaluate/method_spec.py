"""``MethodSpec``: one row of the report, read from an entry of the config or from text of the command line."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

from scjax.evaluate.corruption import LADDER
from scjax.evaluate.retrieval import RULES

IN_ORDER = "in_order"
PAIRINGS = (IN_ORDER, *RULES)
UNCONDITIONAL, RECONSTRUCTION = "none", "reconstruction"
REQUESTS = (
    "counts",
    "lanes",
    "prompt",
    "prompt+counts",
    "shuffled_prompt+counts",
    UNCONDITIONAL,
    RECONSTRUCTION,
)
RANDOM_ON_LANES, COPY = "random on lanes", "copy"
BASELINES = (*RULES, *LADDER, RANDOM_ON_LANES, COPY)


@dataclasses.dataclass(frozen=True)
class MethodSpec:
    """A method whose scenes are evaluated. They come from ``source``, ``model`` or ``baseline``: exactly one of them.

    Attributes:
      name: title of the row.
      source: scenes on disk, "records:FOLDER#val", "npz:FOLDER" or "tiles:FILE" (see ``open_source``).
      pairing: how scenes of ``source`` answer references. "": not at all. "in_order": the first scene answers the first
        reference, and so on. A rule of ``RULES``: each reference gets the scene that the rule retrieves.
      model: folder of a model, or "{model}" for the folder of --config.model.
      request: what the model gets for each reference. "counts": its numbers of lanes and agents. "lanes": its lanes,
        and
        the number of agents. "prompt": its caption. "prompt+counts". "shuffled_prompt+counts": the caption of a
        reference
        at another location, with its own counts. "none": nothing; these scenes answer no reference. "reconstruction":
        the autoencoder encodes and decodes the reference.
      baseline: one of ``BASELINES``: a retrieval rule in the retrieval set, a rung of the corruption ladder, random
        vehicles on the reference's lanes, or a copy of the reference.
      best_of: number of samples per prompt, of which the best by its attributes is repaired and kept.
        Such a row shows what this selection yields; it is no measure of model quality.
      energy_guidance: whether to sample with energy guidance; None: as the model does by default.
    """

    name: str
    source: str = ""
    pairing: str = ""
    model: str = ""
    request: str = ""
    baseline: str = ""
    best_of: int = 1
    energy_guidance: bool | None = None

    def __post_init__(self):
        name = self.name
        if not name:
            raise ValueError(f"a method needs a name: write name=..., not {self}")
        if sum(map(bool, (self.source, self.model, self.baseline))) != 1:
            raise ValueError(
                f"method {name!r}: give exactly one of source=, model= and baseline= (or its bare name, if it is one "
                f"of the baselines {', '.join(BASELINES)})"
            )
        if self.baseline and self.baseline not in BASELINES:
            raise ValueError(f"method {name!r}: baseline must be one of {', '.join(BASELINES)}, not {self.baseline!r}")
        if self.pairing and (not self.source or self.pairing not in PAIRINGS):
            raise ValueError(f"method {name!r}: pairing, of a source, must be one of {', '.join(PAIRINGS)}")
        if self.model and self.request not in REQUESTS:
            raise ValueError(f"method {name!r}: request must be one of {', '.join(REQUESTS)}, not {self.request!r}")
        if self.best_of < 1:
            raise ValueError(f"method {name!r}: best_of must be at least 1, not {self.best_of}")
        self._check_sampling()

    def _check_sampling(self) -> None:
        options = [field for field in ("request", "energy_guidance") if getattr(self, field) not in ("", None)]
        options += ["best_of"] if self.best_of > 1 else []
        if not self.model and options:
            raise ValueError(f"method {self.name!r}: {', '.join(options)} apply to a model: give model=FOLDER")
        if self.request == RECONSTRUCTION and options != ["request"]:
            raise ValueError(
                f"method {self.name!r}: reconstructions are not sampled: leave out {', '.join(options[1:])}"
            )
        if self.best_of > 1 and "prompt" not in self.request:
            raise ValueError(
                f"method {self.name!r}: best_of selects by the prompt, and the request {self.request!r} has none"
            )

    @property
    def title(self) -> str:
        """The name in tables; rows with a selection say so."""
        return f"{self.name} (best of {self.best_of}, repaired)" if self.best_of > 1 else self.name

    @property
    def answers_references(self) -> bool:
        """Whether every scene answers a reference."""
        return bool(self.baseline or self.pairing) or (bool(self.model) and self.request != UNCONDITIONAL)

    @property
    def is_random(self) -> bool:
        """Whether another seed gives other scenes for the same references."""
        sampled = bool(self.model) and self.request not in (UNCONDITIONAL, RECONSTRUCTION)
        return sampled or self.baseline in RULES or self.pairing in RULES

    def with_folders(self, folders: Mapping[str, str]) -> MethodSpec:
        """The spec with "{name}" in source and model replaced.

        Raises:
          ValueError: a name has no folder.
        """

        def folder(match: re.Match[str]) -> str:
            name = match.group(1)
            if not folders.get(name):
                option = "--config.model=FOLDER" if name == "model" else f"--config.folders.{name}=FOLDER"
                raise ValueError(
                    f"method {self.name!r}: {{{name}}} has no folder: give {option}, or methods of your own "
                    "(--config.methods)"
                )
            return folders[name]

        source, model = (re.sub(r"\{(\w+)\}", folder, text) for text in (self.source, self.model))
        return dataclasses.replace(self, source=source, model=model)


_FIELDS = tuple(field.name for field in dataclasses.fields(MethodSpec))
_NEXT_FIELD = re.compile(rf",\s*(?=(?:{'|'.join(_FIELDS)})\s*=)")


def parse_method(entry: str | Mapping[str, Any]) -> MethodSpec:
    """A spec from an entry of ``config.methods``.

    Args:
      entry: the name of a baseline; a dict of the fields of ``MethodSpec``; or text, "name=..., model=...,
        request=...".

    Raises:
      ValueError: the entry describes no method.
    """
    if isinstance(entry, str):
        if entry in BASELINES:
            return MethodSpec(entry, baseline=entry)
        entry = _fields_of_text(entry)
    if unknown := [field for field in entry if field not in _FIELDS]:
        raise ValueError(f"method {dict(entry)}: unknown field {unknown[0]!r}: choose among {', '.join(_FIELDS)}")
    return MethodSpec(**{"name": "", **entry})


def parse_methods(entries: Sequence[str | Mapping[str, Any]], text: str = "") -> list[MethodSpec]:
    """The specs of ``config.methods``, then those of ``config.more``: texts separated by semicolons."""
    further = [part.strip() for part in text.split(";") if part.strip()]
    return [parse_method(entry) for entry in (*entries, *further) if entry]


def _fields_of_text(text: str) -> dict[str, Any]:
    if "=" not in text:
        raise ValueError(
            f"method {text!r}: write name=..., source=... or name=..., model=..., request=..., or one of the baselines "
            f"{', '.join(BASELINES)}"
        )
    _reject_old_form(text)
    fields: dict[str, Any] = {}
    for part in _NEXT_FIELD.split(text):
        field, _, value = part.partition("=")
        fields[field.strip()] = value.strip()
    if "best_of" in fields:
        if not fields["best_of"].isdecimal():
            raise ValueError(f"method {text!r}: best_of must be a whole number, not {fields['best_of']!r}")
        fields["best_of"] = int(fields["best_of"])
    if "energy_guidance" in fields:
        values = {"true": True, "false": False}
        if fields["energy_guidance"].lower() not in values:
            raise ValueError(f"method {text!r}: energy_guidance must be true or false")
        fields["energy_guidance"] = values[fields["energy_guidance"].lower()]
    return fields


_OLD_REQUESTS = {
    "drawn": UNCONDITIONAL,
    "decoded": RECONSTRUCTION,
    "other prompt+counts": "shuffled_prompt+counts",
}
_OLD_OPTIONS = {
    "picked": ", best_of=8",
    "guided": ", energy_guidance=true",
    "steered": ", energy_guidance=true",
    "unguided": ", energy_guidance=false",
    "unsteered": ", energy_guidance=false",
}


def _reject_old_form(text: str) -> None:
    """NAME=model:FOLDER#REQUEST?OPTION and NAME=SOURCE?RULE were the form of version 0.1: answers with today's."""
    name, _, rest = text.partition("=")
    if name in _FIELDS or not re.match(r"(model|records|npz|tiles):", rest):
        return
    place, _, option = rest.partition("?")
    if rest.startswith("model:"):
        folder, _, request = place.removeprefix("model:").partition("#")
        request, option = _OLD_REQUESTS.get(request, request), _OLD_OPTIONS.get(option, "")
        new = f"name={name}, model={folder}, request={request}{option}"
    else:
        pairing = {"": "", "inorder": f", pairing={IN_ORDER}"}.get(option, f", pairing={option}")
        new = f"name={name}, source={place}{pairing}"
    raise ValueError(f"method {text!r} has the form of an earlier version: write {new!r}")
