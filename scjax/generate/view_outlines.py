"""Outlines of windows ahead of the ego, and which of them a picture looks like.

A linear map from the features of a picture says how many lanes and agents of each kind its window has. An outline with
similar numbers is drawn, and where lanes are seen one whose lanes lie like these (``view_roads``). The map is fitted in
closed form to the pictures of the training.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from scjax.generate.seen_lanes import FEWEST, SeenLanes
from scjax.generate.view_roads import BYTES, misfits
from scjax.models.denoiser.kinds import digits_of

VIEW_ARRAYS = ("lanes", "agents", "domains", "weights", "deviations")
_ROADS = "roads"

_POOLED = (4, 7)  # parts of a picture, rows and columns, whose features are averaged
_FIRST_ROW = 0.15  # share of the picture above the parts
_RIDGE = 30.0
_NEAREST = 4  # outlines among which one is drawn
_LANE, _AGENT = 10.0, 0.3
"""Distance of a lane and an agent too many or too few, where their number is given. Layouts of lanes that look like the
picture and have nearly this number serve better than those of this number that look least unlike it."""

_SEEN = 500.0
"""Weight of how badly lanes fit those that are seen (``view_roads.misfits``), beside squared shares of deviations."""


@dataclasses.dataclass(frozen=True)
class ViewOutlines:
    """Outlines of forward windows and the map from pictures to numbers of kinds.

    Attributes:
      lanes, agents: kinds in token order, the ego first, then ``NO_KIND`` [scenes, tokens].
      domains: index of each scene's domain [scenes].
      weights: the map [features of a picture and 1, numbers].
      deviations: of its errors [numbers].
      lane_sizes, agent_sizes: sizes of the digits of kinds.
      roads: bins of each window that lanes go through, packed [scenes, bytes]; None: not known.
    """

    lanes: np.ndarray
    agents: np.ndarray
    domains: np.ndarray
    weights: np.ndarray
    deviations: np.ndarray
    lane_sizes: tuple[int, ...]
    agent_sizes: tuple[int, ...]
    roads: np.ndarray | None = None

    @classmethod
    def fit(
        cls,
        lanes: Int[np.ndarray, "scenes lanes"],
        agents: Int[np.ndarray, "scenes agents"],
        domains: Int[np.ndarray, " scenes"],
        pictures: Float32[np.ndarray, "scenes features"],
        sizes: tuple[tuple[int, ...], tuple[int, ...]],
        most: int,
        roads: UInt8[np.ndarray, "scenes bytes"] | None = None,
    ) -> ViewOutlines:
        """The map of least squares, and at most ``most`` of the outlines.

        Args:
          pictures: ``picture_features`` of each scene.
          sizes: of the digits of the kinds of lanes and of agents.
          roads: ``view_roads.lane_bins`` of each scene.
        """
        numbers = kind_numbers(lanes, sizes[0]), kind_numbers(agents, sizes[1])
        targets = np.concatenate(numbers, 1).astype(np.float64)
        inputs = np.concatenate([pictures, np.ones((len(pictures), 1), np.float32)], 1).astype(np.float64)
        scale = np.maximum(inputs.std(0), 1e-3)
        scale[-1] = 1.0
        scaled = inputs / scale
        gram = scaled.T @ scaled
        gram[np.diag_indices_from(gram)] += _RIDGE
        weights = np.linalg.solve(gram, scaled.T @ targets) / scale[:, None]
        # Errors on pictures that were fitted are too small; those of a fit to the first half on the second are not.
        half = len(scaled) // 2
        part = scaled[:half].T @ scaled[:half]
        part[np.diag_indices_from(part)] += _RIDGE
        others = scaled[half:] @ np.linalg.solve(part, scaled[:half].T @ targets[:half])
        deviations = np.maximum((others - targets[half:]).std(0), 0.1)
        rows = np.unique(np.linspace(0, len(lanes) - 1, min(len(lanes), most)).astype(int))
        return cls(
            lanes[rows].astype(np.int32),
            agents[rows].astype(np.int16),
            domains[rows].astype(np.int16),
            weights.astype(np.float32),
            deviations.astype(np.float32),
            *sizes,
            None if roads is None else roads[rows],
        )

    @classmethod
    def from_files(
        cls, arrays: Mapping[str, np.ndarray], sizes: tuple[tuple[int, ...], tuple[int, ...]]
    ) -> ViewOutlines:
        """The inverse of ``arrays()``, for a network with kinds of these sizes.

        Raises:
          ValueError: the parts do not fit each other; names the part.
        """
        if missing := sorted(set(VIEW_ARRAYS) - arrays.keys()):
            raise ValueError(f"view outlines: {missing[0]} is missing")
        parts = {name: arrays[name] for name in VIEW_ARRAYS}
        views = cls(**parts, lane_sizes=sizes[0], agent_sizes=sizes[1], roads=arrays.get(_ROADS))
        views.check()
        return views

    def arrays(self) -> dict[str, np.ndarray]:
        """Name -> array, for files."""
        arrays = {name: getattr(self, name) for name in VIEW_ARRAYS}
        return arrays if self.roads is None else arrays | {_ROADS: self.roads}

    def check(self) -> None:
        """Whether the parts fit each other.

        Raises:
          ValueError: names the part.
        """
        numbers = 2 + sum(self.lane_sizes) + sum(self.agent_sizes)
        scenes = len(self.domains)
        for name, ndim, length in (("lanes", 2, scenes), ("agents", 2, scenes), ("domains", 1, scenes)):
            array = getattr(self, name)
            if array.dtype.kind != "i" or array.ndim != ndim or len(array) != length or not scenes:
                raise ValueError(f"view outlines: {name} has shape {array.shape} and type {array.dtype}")
        if self.roads is not None and (self.roads.shape != (scenes, BYTES) or self.roads.dtype != np.uint8):
            raise ValueError(f"view outlines: {_ROADS} has shape {self.roads.shape} and type {self.roads.dtype}")
        for name, sizes in (("lanes", self.lane_sizes), ("agents", self.agent_sizes)):
            if (getattr(self, name) >= max(math.prod(sizes), 1)).any() or (getattr(self, name) < -1).any():
                raise ValueError(f"view outlines: {name} has kinds that the denoiser does not know")
        if self.weights.ndim != 2 or self.weights.shape[1] != numbers or self.deviations.shape != (numbers,):
            raise ValueError(
                f"view outlines: weights {self.weights.shape} and deviations {self.deviations.shape} are not of "
                f"{numbers} numbers"
            )
        if not (np.isfinite(self.weights).all() and (self.deviations > 0).all()):
            raise ValueError("view outlines: weights or deviations are not finite and positive")

    def draw(
        self,
        rng: np.random.Generator,
        tokens: Float[np.ndarray, "cells channels"],
        grid: tuple[int, int],
        *,
        num_lanes: int | None = None,
        num_agents: int | None = None,
        seen: SeenLanes | None = None,
    ) -> int:
        """A scene of the nearest ones to a picture.

        Args:
          tokens: of the cells of the picture, row-major; grid: its rows and columns.
          num_lanes, num_agents: near in these, too, if given.
          seen: lanes that the picture shows; the outline's lanes lie nearly like them.

        Raises:
          ValueError: the picture has other features than those that were fitted.
        """
        features = np.append(picture_features(tokens, grid), np.float32(1))
        if len(features) != len(self.weights):
            raise ValueError(f"view outlines: a picture has {len(features)} features, not {len(self.weights)}")
        estimate = features @ self.weights
        distances = (((self._numbers - estimate) / self.deviations) ** 2).sum(1)
        for kinds, number, each in ((self.lanes, num_lanes, _LANE), (self.agents, num_agents, _AGENT)):
            if number is not None:
                distances = distances + each * np.abs((kinds >= 0).sum(1) - number)
        if seen is not None and self.roads is not None and len(seen.points) >= FEWEST:
            distances = distances + _SEEN * misfits(self.roads, seen)
        return int(rng.choice(np.argsort(distances, kind="stable")[:_NEAREST]))

    @functools.cached_property
    def _numbers(self) -> Float32[np.ndarray, "scenes numbers"]:
        """Numbers of kinds of all outlines."""
        numbers = kind_numbers(self.lanes, self.lane_sizes), kind_numbers(self.agents, self.agent_sizes)
        return np.concatenate(numbers, 1)


def picture_features(
    tokens: Float[np.ndarray, "cells channels"], grid: tuple[int, int]
) -> Float32[np.ndarray, " features"]:
    """Means of the tokens in parts of a picture, without its upper edge."""
    rows, columns = grid
    cells = np.asarray(tokens, np.float32).reshape(rows, columns, -1)
    top = int(_FIRST_ROW * rows)
    parts = [
        part.mean((0, 1))
        for band in np.array_split(cells[top:], min(_POOLED[0], rows - top), 0)
        for part in np.array_split(band, min(_POOLED[1], columns), 1)
    ]
    return np.concatenate(parts)


def kind_numbers(
    kinds: Int[np.ndarray, "scenes tokens"], sizes: Sequence[int]
) -> Float32[np.ndarray, "scenes numbers"]:
    """How many tokens each scene has, in all and with each value of each digit."""
    are_tokens = kinds >= 0
    columns = [are_tokens.sum(1)]
    for digit, size in zip(digits_of(np.maximum(kinds, 0).astype(np.int64), sizes), sizes, strict=True):
        columns += [((np.asarray(digit) == value) & are_tokens).sum(1) for value in range(size)]
    return np.stack(columns, 1).astype(np.float32)
