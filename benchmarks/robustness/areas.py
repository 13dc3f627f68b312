"""The areas by name: their inputs and the seconds that one input may take."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.robustness import (
    areas_commands,
    areas_encoders,
    areas_models,
    areas_records,
    areas_requests,
    areas_scenes,
    areas_training,
)
from benchmarks.robustness.case import Case


class Area(NamedTuple):
    """Inputs of one kind.

    Attributes:
      inputs: (random numbers, folder of fixtures) -> damaged inputs.
      seconds: of processor time that an input may take; more where networks are compiled.
    """

    inputs: Callable[[np.random.Generator, Path], Iterator[Case]]
    seconds: float = 30.0


AREAS: dict[str, Area] = {
    "recorded": Area(areas_scenes.recorded),
    "own-json": Area(areas_scenes.own_json),
    "own-npz": Area(areas_scenes.own_npz),
    "logs": Area(areas_scenes.logs),
    "records": Area(areas_records.records),
    "shards": Area(areas_records.shards),
    "descriptions": Area(areas_records.descriptions),
    "measurements": Area(areas_records.measurements),
    "encoders": Area(areas_encoders.encoders),
    "prompts": Area(areas_encoders.prompts),
    "official": Area(areas_models.official, 60.0),
    "checkpoints": Area(areas_training.checkpoints),
    "configs": Area(areas_training.configs, 60.0),
    "commands": Area(areas_commands.commands, 60.0),
    "models": Area(areas_models.models, 60.0),
    "requests": Area(areas_requests.requests, 60.0),
}
