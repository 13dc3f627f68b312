"""What a stream of training batches looks like, checked before anything of its size is prepared."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np

from scjax.scene import Crop

Bucket = tuple[int, int]  # (agent slots, lane slots)

MAX_SLOTS = 65536
"""Largest number of padded slots, and of scenes in a batch."""

_INTEGERS = {  # fields of LoaderConfig -> range
    "batch_size": (1, MAX_SLOTS),
    "text_slots": (1, MAX_SLOTS),
    "seed": (0, 2**32 - 1),
    "workers": (1, 1024),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class LoaderConfig:
    """What a stream of training batches looks like.

    Attributes:
      batch_size: scenes a batch, over all processes.
      buckets: (agent slots, lane slots) of the padded shapes, smallest first; all scenes of a batch share one.
      crops: relative frequencies of the centered, partitioned and forward crop.
      jitter_position: largest shift of the pose along x and along y [m].
      jitter_heading: largest rotation of the pose [degrees].
      order: "shuffle" permutes all but the ego (autoencoder), "recursive" sorts (denoiser; official-spec §3).
      text_slots: largest number of tokens of a caption; the rest is cut off. Batches have as many slots as the
        longest caption needs (``TextStore.slots``), so that few are padding.
      seed: seed of everything random in the stream.
      workers: threads that prepare examples ahead of their step.

    Raises:
      ValueError: naming a field of another type or out of its range.
    """

    batch_size: int = 16
    buckets: tuple[Bucket, ...] = ((12, 16), (16, 28), (32, 48), (61, 100))
    crops: tuple[float, float, float] = (1.0, 1.0, 1.0)
    jitter_position: float = 2.0
    jitter_heading: float = 10.0
    order: Literal["shuffle", "recursive"] = "shuffle"
    text_slots: int = 96
    seed: int = 0
    workers: int = 1

    @classmethod
    def from_json(cls, fields: dict[str, Any], **changes: Any) -> LoaderConfig:
        """A config from its JSON fields, in which lists stand for tuples."""
        return cls(**{**{name: _as_tuples(value) for name, value in fields.items()}, **changes})

    def __post_init__(self):
        for name, (least, most) in _INTEGERS.items():
            if not _is_integer(getattr(self, name), least, most):
                raise ValueError(f"{name} must be an integer of {least} to {most}, not {getattr(self, name)!r}")
        if not _is_tuple(self.buckets) or not all(_is_bucket(bucket) for bucket in self.buckets):
            raise ValueError(f"buckets must be (agents, lanes) pairs of 1 to {MAX_SLOTS} each, not {self.buckets!r}")
        if not self.buckets or list(self.buckets) != sorted(self.buckets):
            raise ValueError(f"buckets must be (agents, lanes) pairs, smallest first, not {self.buckets}")
        if not _is_tuple(self.crops) or not all(_is_number(share, math.inf) for share in self.crops):
            raise ValueError(f"crops must be finite frequencies of at least 0, not {self.crops!r}")
        if len(self.crops) != len(Crop) or sum(self.crops) <= 0:
            raise ValueError(f"crops must be three frequencies of positive sum, not {self.crops}")
        for name, most in (("jitter_position", 80.0), ("jitter_heading", 180.0)):
            if not _is_number(getattr(self, name), most):
                raise ValueError(f"{name} must be a number of 0 to {most:g}, not {getattr(self, name)!r}")
        if self.order not in ("shuffle", "recursive"):
            raise ValueError(f'order must be "shuffle" or "recursive", not {self.order!r}')


def _is_integer(value: Any, least: int, most: int) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(least <= value <= most)


def _is_number(value: Any, most: float) -> bool:
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return is_number and math.isfinite(value) and bool(0 <= value <= most)


def _is_tuple(value: Any) -> bool:
    return isinstance(value, tuple | list)


def _is_bucket(value: Any) -> bool:
    return _is_tuple(value) and len(value) == 2 and all(_is_integer(slots, 1, MAX_SLOTS) for slots in value)


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list | tuple) else value
