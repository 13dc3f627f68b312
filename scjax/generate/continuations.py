"""What lies beyond the seam in partitioned windows of a training: kinds of lanes and agents at x > 0, by their seams.

Outpainting draws one whose lanes cross the seam where those of the known half do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int, UInt8

from scjax.models.denoiser.kinds import NO_KIND
from scjax.scene import TILE_SIZE, Scene

CONTINUATION_ARRAYS = ("lanes", "agents", "seams")

_BIN = 2.0  # m of the seam
_BINS = int(TILE_SIZE / _BIN)
_REACH = 1.0  # m from the seam, within which a lane meets it
_STEEPEST = 0.5  # cosine of the angle to the normal of the seam
_ENOUGH = 30  # windows among which the request decides
_BLUR = np.array([0.5, 1.0, 0.5])


@dataclasses.dataclass(frozen=True)
class Continuations:
    """Partitioned windows of many scenes, beyond their seams.

    Attributes:
      lanes, agents: kinds in token order, then ``NO_KIND`` [scenes, tokens].
      seams: how many known lanes leave (first half) and enter (second half) across each 2 m [scenes, 64].
    """

    lanes: np.ndarray
    agents: np.ndarray
    seams: np.ndarray

    @classmethod
    def of_scenes(
        cls,
        lanes: list[Int[np.ndarray, " _"]],
        agents: list[Int[np.ndarray, " _"]],
        seams: list[UInt8[np.ndarray, " 64"]],
    ) -> Continuations:
        """Continuations of the windows with these kinds beyond these seams."""
        return cls(_padded(lanes, np.int32), _padded(agents, np.int16), np.stack(seams))

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Continuations:
        """The inverse of ``CONTINUATION_ARRAYS``."""
        return cls(**{name: arrays[name] for name in CONTINUATION_ARRAYS})

    def check(self, scenes: int) -> None:
        """Whether the parts fit each other.

        Raises:
          ValueError: names the part.
        """
        for name in CONTINUATION_ARRAYS:
            array = np.asarray(getattr(self, name))
            if array.dtype.kind not in "iu" or array.ndim != 2 or len(array) != scenes:
                raise ValueError(f"outlines: {name} of continuations has shape {array.shape} and type {array.dtype}")
        if self.seams.shape[1] != 2 * _BINS:
            raise ValueError(f"outlines: seams of continuations have {self.seams.shape[1]} bins, not {2 * _BINS}")

    def nearest(self, known: Scene) -> Int[np.ndarray, " rows"]:
        """The windows whose seams are most like that of a known half: all equally good ones, but at least 30.

        Args:
          known: the known elements, unpadded.
        """
        distance = np.abs(_blurred(self.seams) - _blurred(seam_crossings(known)[None])).sum(-1)
        order = np.sort(distance, kind="stable")
        return np.flatnonzero(distance <= max(order[0], order[min(_ENOUGH, len(order)) - 1]))


def seam_crossings(scene: Scene) -> UInt8[np.ndarray, " bins"]:
    """How many lanes of a half at x <= 0 leave and enter across each 2 m of the seam, as in ``Continuations.seams``."""
    lanes = np.asarray(scene.lanes, np.float64)[..., :2]
    crossings = np.zeros((2, _BINS), np.uint8)
    for row, (place, direction) in enumerate(
        ((lanes[:, -1], lanes[:, -1] - lanes[:, -2]), (lanes[:, 0], lanes[:, 0] - lanes[:, 1]))
    ):
        ahead = direction[:, 0] > _STEEPEST * np.hypot(*direction.T)
        meets = ahead & (np.abs(place[:, 0]) < _REACH)
        bins = np.clip((place[meets, 1] + TILE_SIZE / 2) // _BIN, 0, _BINS - 1).astype(int)
        np.add.at(crossings[row], bins, 1)
    return crossings.reshape(-1)


def _blurred(seams: np.ndarray) -> Float[np.ndarray, "scenes bins"]:
    rows = np.pad(seams.reshape(len(seams), 2, _BINS).astype(np.float32), ((0, 0), (0, 0), (1, 1)))
    parts = [weight * rows[..., k : k + _BINS] for k, weight in enumerate(_BLUR)]
    return np.sum(parts, axis=0).reshape(len(seams), -1)


def _padded(kinds: list[np.ndarray], dtype: type) -> np.ndarray:
    table = np.full((len(kinds), max(map(len, kinds), default=0)), NO_KIND, dtype)
    for row, one in zip(table, kinds, strict=True):
        row[: len(one)] = one
    return table
