"""Outlines of scenes: the kinds of all lanes and agents in token order, with the attributes of each scene.

An outline says what is there. Of places it says the order of the tokens, which is along x, and the side of the ego. A
model keeps those of scenes of its training; one that fulfills a request is drawn before sampling.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int

from scjax.generate.continuations import CONTINUATION_ARRAYS, Continuations
from scjax.generate.outline_trials import TRIAL_ARRAYS, Trials
from scjax.language.attributes.table import ATTRIBUTES
from scjax.models.denoiser.kinds import LANE_DIGITS, NO_KIND, digits_of

ARRAYS = ("lanes", "agents", "domains", "measured")

_AHEAD, _TRIALS = "ahead.", "trials."  # begin the names of the arrays of continuations and of trials
_JOINT_WEIGHT = 0.5  # of a lane's joints beside its direction, side and turn
_AGENT_WEIGHT = 0.5  # of an agent too many or too few beside a lane of another kind
_TENTHS = 10  # lengths are kept to 0.1 m
_FITTED = ("vehicles", "pedestrians", "cyclists", "static", "large")  # agents are added or left out to these numbers
_ENOUGH = 30  # outlines among which one is drawn, at least, if so many show the request equally
_EQUAL = 1e-4  # of mean numbers of attributes
_LIKELY = 0.3  # of an attribute that a prompt may ask for, beside one that it asks for


@dataclasses.dataclass(frozen=True)
class Outlines:
    """Outlines of many scenes.

    Attributes:
      lanes, agents: kinds in token order, the ego first, then ``NO_KIND`` [scenes, tokens].
      domains: index of each scene's domain [scenes].
      measured: of every scene and attribute, the position of its measurement in ``values`` [scenes, attributes].
      values: attribute -> its different measurements.
      ahead: what lies ahead of the ego in the same scenes, by its seam; None: not kept.
      trials: what the model made of each outline; None: not tried.
    """

    lanes: np.ndarray
    agents: np.ndarray
    domains: np.ndarray
    measured: np.ndarray
    values: Mapping[str, Sequence[Any]]
    ahead: Continuations | None = None
    trials: Trials | None = None

    @classmethod
    def of_scenes(
        cls,
        lanes: Int[np.ndarray, "scenes lanes"],
        agents: Int[np.ndarray, "scenes agents"],
        domains: Int[np.ndarray, " scenes"],
        measured: Sequence[Mapping[str, Any]],
        ahead: Continuations | None = None,
    ) -> Outlines:
        """Outlines of scenes with these measurements (``measure_attributes``)."""
        columns, values = [], {}
        for name in ATTRIBUTES:
            column = [_rounded(scene[name]) for scene in measured]
            values[name] = list(dict.fromkeys(column))
            place = {value: k for k, value in enumerate(values[name])}
            columns.append([place[value] for value in column])
        places = np.array(columns, np.int16).reshape(len(ATTRIBUTES), len(measured)).T
        return cls(lanes.astype(np.int32), agents.astype(np.int16), domains.astype(np.int16), places, values, ahead)

    @classmethod
    def from_files(cls, arrays: Mapping[str, np.ndarray], values: Mapping[str, Sequence[Any]]) -> Outlines:
        """The inverse of ``arrays()`` and ``values``, whose measurements JSON turned into lists.

        Raises:
          ValueError: the parts do not fit each other; names the part.
        """
        if values.keys() != ATTRIBUTES.keys():
            raise ValueError("outlines were measured with another table of attributes")
        checked = {
            name: [attribute.check_measured(value) for value in values[name]] for name, attribute in ATTRIBUTES.items()
        }
        ahead, trials = (_part(arrays, prefix) for prefix in (_AHEAD, _TRIALS))
        outlines = cls(
            **{name: arrays[name] for name in ARRAYS},
            values=checked,
            ahead=Continuations.from_arrays(ahead) if ahead else None,
            trials=Trials.from_arrays(trials) if trials else None,
        )
        outlines.check()
        return outlines

    def with_trials(self, measured: Sequence[Sequence[Mapping[str, Any]]], faults: Sequence[Sequence[int]]) -> Outlines:
        """The same outlines with what a model made of them.

        Args:
          measured, faults: of every outline, the measurements and the number of faults of each of its trials.
        """
        rounded = [[{name: _rounded(value) for name, value in one.items()} for one in trials] for trials in measured]
        trials, values = Trials.of_scenes(rounded, faults, self.values)
        return dataclasses.replace(self, trials=trials, values=values)

    def arrays(self) -> dict[str, np.ndarray]:
        """Name -> array of everything but ``values``, for files."""
        arrays = {name: getattr(self, name) for name in ARRAYS}
        if self.ahead is not None:
            arrays |= {f"{_AHEAD}{name}": getattr(self.ahead, name) for name in CONTINUATION_ARRAYS}
        if self.trials is not None:
            arrays |= {f"{_TRIALS}{name}": getattr(self.trials, name) for name in TRIAL_ARRAYS}
        return arrays

    def check(self) -> None:
        """Whether the parts fit each other.

        Raises:
          ValueError: names the part.
        """
        scenes = len(self.domains)
        for name, ndim in (("lanes", 2), ("agents", 2), ("domains", 1), ("measured", 2)):
            array = np.asarray(getattr(self, name))
            if array.dtype.kind != "i" or array.ndim != ndim or len(array) != scenes or not scenes:
                raise ValueError(f"outlines: {name} has shape {array.shape} and type {array.dtype}")
        sizes = np.array([len(self.values.get(name, ())) for name in ATTRIBUTES])
        if self.measured.shape[1:] != sizes.shape or ((self.measured < 0) | (self.measured >= sizes)).any():
            raise ValueError("outlines: measured points outside values")
        if self.ahead is not None:
            self.ahead.check(scenes)
        if self.trials is not None:
            self.trials.check(scenes, sizes)

    def __len__(self) -> int:
        return len(self.domains)

    def measurements(self, row: int) -> dict[str, Any]:
        """Attribute -> measurement of one scene, lengths to 0.1 m."""
        return {name: self.values[name][place] for name, place in zip(ATTRIBUTES, self.measured[row], strict=True)}

    def count_held(self, request: Mapping[str, Any]) -> Int[np.ndarray, " scenes"]:
        """Of every scene, how many attributes of a request in its normal form it shows."""
        held = np.zeros(len(self), np.int32)
        for column, (name, attribute) in enumerate(ATTRIBUTES.items()):
            if name in request:
                fits = np.array([attribute.holds(request[name], value) for value in self.values[name]], bool)
                held += fits[self.measured[:, column]]
        return held

    def missed_by(self, row: int, request: Mapping[str, Any]) -> set[str]:
        """Attributes of a request in its normal form that one scene does not show."""
        return {
            name
            for column, (name, attribute) in enumerate(ATTRIBUTES.items())
            if name in request and not attribute.holds(request[name], self.values[name][self.measured[row, column]])
        }

    def draw(
        self,
        rng: np.random.Generator,
        request: Mapping[str, Any],
        *,
        likely: Mapping[str, Any] | None = None,
        negative: Mapping[str, Any] | None = None,
        domain: int | None = None,
        num_lanes: int | None = None,
        num_agents: int | None = None,
        among: Int[np.ndarray, " rows"] | None = None,
        lanes: Int[np.ndarray, " tokens"] | None = None,
        count_misses: Callable[[Int[np.ndarray, "rows agents"]], np.ndarray] | None = None,
    ) -> int:
        """A scene of those that show most of the request; numbers of agents decide last, since they can be changed.

        What trials of an outline show counts as much as what its scene shows. Of these it shows least of ``negative``,
        is of the domain if any of them is, and is nearest in numbers; with ``lanes``, kinds of lanes that are known, it
        is nearest to these and to the number of agents. Of many that are equal it is one whose kinds of agents show the
        request and in whose trials few lanes have faults.

        Args:
          likely: further attributes, that count less.
          among: the scenes to choose from; None: all.
          count_misses: of kinds of agents, how much of the request these do not show [rows].
        """
        trials = self.trials if among is None and lanes is None and request else None
        rows = np.arange(len(self)) if among is None else among
        (others, numbers), (likely_others, likely_numbers) = map(_split, (request, likely or {}))
        held = (self.count_held(others) + _LIKELY * self.count_held(likely_others))[rows].astype(np.float32)
        if trials is not None:
            held += trials.mean_held(others, self.values)
        rows = rows[held >= held.max() - _EQUAL]
        held = (self.count_held(numbers) + _LIKELY * self.count_held(likely_numbers))[rows]
        rows = rows[held >= held.max() - _EQUAL]
        unwanted = self.count_held(negative or {})[rows]
        rows = rows[unwanted == unwanted.min()]
        rows = _those(rows, np.ones(len(rows), bool) if domain is None else self.domains[rows] == domain)
        if lanes is not None:
            distance = np.abs(_lane_counts(self.lanes[rows]) - _lane_counts(lanes[None])).sum(1)
            if num_agents is not None:
                distance += _AGENT_WEIGHT * np.abs((self.agents[rows] != NO_KIND).sum(1) - num_agents)
            return int(rng.choice(rows[distance == distance.min()]))
        for kinds, number in ((self.lanes, num_lanes), (self.agents, num_agents)):
            if number is not None:
                distance = np.abs((kinds[rows] != NO_KIND).sum(1) - number)
                rows = rows[distance == distance.min()]
        penalties = np.zeros(len(rows), np.float32)
        if count_misses is not None:
            penalties += count_misses(self.agents[rows])
        if trials is not None:
            penalties += trials.mean_faulty(rows)
        return int(rng.choice(rows[penalties <= np.sort(penalties)[:_ENOUGH][-1]]))


def _split(request: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A request without numbers of agents, and these numbers."""
    numbers = {name: value for name, value in request.items() if name in _FITTED}
    return {name: value for name, value in request.items() if name not in _FITTED}, numbers


def _part(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _lane_counts(kinds: Int[np.ndarray, "scenes lanes"]) -> Float32[np.ndarray, "scenes counts"]:
    """How many lanes of every scene have each direction and side of the ego, direction and turn, and joints."""
    digits = [np.asarray(digit) for digit in digits_of(np.maximum(kinds, 0), LANE_DIGITS)]
    direction, turn, _, joints, _, side, _ = digits
    directions, turns, _, many_joints, _, sides, _ = LANE_DIGITS
    rows, tokens = np.nonzero(kinds != NO_KIND)

    def counts(digit: np.ndarray, size: int) -> np.ndarray:
        place = rows * size + digit[rows, tokens]
        return np.bincount(place, minlength=len(kinds) * size).reshape(len(kinds), size)

    parts = (
        counts(direction * sides + side, directions * sides),
        counts(direction * turns + turn, directions * turns),
        _JOINT_WEIGHT * counts(joints, many_joints),
    )
    return np.concatenate(parts, axis=1).astype(np.float32)


def _those(rows: Int[np.ndarray, " n"], selected: Bool[np.ndarray, " n"]) -> Int[np.ndarray, " m"]:
    return rows[selected] if selected.any() else rows


def _rounded(value: Any) -> Any:
    return round(value * _TENTHS) / _TENTHS if isinstance(value, float) else value
