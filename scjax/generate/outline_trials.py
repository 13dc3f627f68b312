"""What a model makes of its outlines: a few scenes sampled from each, measured once after the training.

Some outlines are drawn as they are meant, others lose an attribute in most samples. Of outlines that show a request
equally well, those are drawn whose trials show it, and whose lanes have no faults there. (Faults of agents do not
count: scenes with few agents have fewer, so that scenes of a request would become emptier than those of the world.)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float32, Int

from scjax.language.attributes.table import ATTRIBUTES

TRIAL_ARRAYS = ("measured", "faults")

_MOST_FAULTS = 127  # that are counted


@dataclasses.dataclass(frozen=True)
class Trials:
    """Scenes sampled from outlines.

    Attributes:
      measured: of every outline, trial and attribute, the position of the measurement in the values of the outlines
        [outlines, trials, attributes].
      faults: of every outline and trial, faults of the lanes (``best_of.count_lane_faults``) [outlines, trials].
    """

    measured: np.ndarray
    faults: np.ndarray

    @classmethod
    def of_scenes(
        cls,
        measured: Sequence[Sequence[Mapping[str, Any]]],
        faults: Sequence[Sequence[int]],
        values: Mapping[str, Sequence[Any]],
    ) -> tuple[Trials, dict[str, list[Any]]]:
        """Trials with these measurements, and the values of the outlines with those that were not among them.

        Args:
          measured, faults: of every outline, those of its trials.
          values: attribute -> different measurements of the outlines.
        """
        columns, more = [], {}
        for name in ATTRIBUTES:
            place = {value: k for k, value in enumerate(values[name])}
            rows = [[place.setdefault(one[name], len(place)) for one in trials] for trials in measured]
            columns.append(np.array(rows, np.int16))
            more[name] = list(place)
        counts = np.minimum(np.array(faults), _MOST_FAULTS).astype(np.int8)
        return cls(np.stack(columns, axis=-1), counts), more

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Trials:
        """The inverse of ``TRIAL_ARRAYS``."""
        return cls(**{name: arrays[name] for name in TRIAL_ARRAYS})

    def check(self, scenes: int, sizes: Int[np.ndarray, " attributes"]) -> None:
        """Whether the parts fit each other.

        Args:
          sizes: how many values each attribute has.

        Raises:
          ValueError: names the part.
        """
        for name, shape in (("measured", (scenes, -1, len(sizes))), ("faults", (scenes, -1))):
            array = np.asarray(getattr(self, name))
            fits = array.ndim == len(shape) and all(
                own == size or size == -1 for own, size in zip(array.shape, shape, strict=True)
            )
            if array.dtype.kind != "i" or not fits or not array.size:
                raise ValueError(f"outlines: {name} of trials has shape {array.shape} and type {array.dtype}")
        if self.faults.shape[1] != self.measured.shape[1]:
            raise ValueError("outlines: measured and faults are not of the same trials")
        if ((self.measured < 0) | (self.measured >= sizes)).any():
            raise ValueError("outlines: measured of trials points outside values")

    def mean_held(
        self, request: Mapping[str, Any], values: Mapping[str, Sequence[Any]]
    ) -> Float32[np.ndarray, " outlines"]:
        """Of every outline, how many attributes of a request in its normal form its trials show on average.

        Args:
          values: attribute -> different measurements, of the outlines.
        """
        held = np.zeros(len(self.measured), np.float32)
        for column, (name, attribute) in enumerate(ATTRIBUTES.items()):
            if name in request:
                fits = np.array([attribute.holds(request[name], value) for value in values[name]], bool)
                held += fits[self.measured[..., column]].mean(1)
        return held

    def mean_faulty(self, rows: Int[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
        """Of some outlines, the share of trials with a fault of the lanes."""
        return (self.faults[rows] > 0).mean(1).astype(np.float32)
