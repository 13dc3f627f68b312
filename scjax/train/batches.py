"""Where the batches of a run come from: record folders, logs of motion, or pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax

from scjax.data.loader import LoaderConfig, training_batches
from scjax.generate.model import Model, save_model
from scjax.train.motion.loader import MotionLoaderConfig
from scjax.train.objectives.base import Objective, SceneObjective, StreamObjective, Weights
from scjax.train.picture_loader import PictureLoaderConfig


@runtime_checkable
class Batches(Protocol):
    """Endless batches with an ``index`` of each row, which resume to the very next one."""

    def __next__(self) -> Any:
        """The next batch."""
        ...

    def state(self) -> dict[str, Any]:
        """JSON-serializable state after the last batch."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continues after the batch at which ``state`` was taken."""
        ...


AnyLoaderConfig = LoaderConfig | MotionLoaderConfig | PictureLoaderConfig


def loader_config(resolved: dict[str, Any]) -> AnyLoaderConfig:
    """What the stream of a run looks like.

    Raises:
      ValueError: naming a field of another type or out of its range.
    """
    batch = resolved["batch"]
    if "pictures" in resolved:
        return PictureLoaderConfig(**batch)
    return MotionLoaderConfig(**batch) if "logs" in resolved else LoaderConfig.from_json(batch)


def open_batches(objective: Objective, records: str, loader: AnyLoaderConfig) -> Batches:
    """The stream of this process.

    Args:
      records: folder of records, "" for objectives with streams of their own.

    Raises:
      ValueError: what the stream reads is damaged, or does not fit.
    """
    place: dict[str, Any] = {"process": jax.process_index(), "processes": jax.process_count()}
    if isinstance(objective, StreamObjective):
        return objective.batches(loader, **place)
    if not isinstance(objective, SceneObjective) or not isinstance(loader, LoaderConfig):
        raise ValueError(f"{type(objective).__name__} reads no records and has no batches of its own")
    return training_batches(
        records,
        objective.codec,
        loader,
        texts=objective.texts,
        measurements=objective.measurements,
        ahead=objective.ahead,
        images=objective.images,
        **place,
    )


def save_export(model: Model | Weights, folder: Path) -> Path:
    """Writes what a run exports and returns its folder."""
    return save_model(model, folder) if isinstance(model, Model) else model.save(folder)
