"""Small worlds on disk, configs over them, and model functions without a network, for tests of evaluations."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ml_collections import ConfigDict

from scjax.evaluate.config import get_config
from scjax.evaluate.generated import ModelFunctions, SamplingOptions
from scjax.evaluate.run import run_evaluation
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.models.codec import scjax
from scjax.models.latents import LatentStatistics
from scjax.scene import Scene, stack
from scjax.scene.io import save_npz
from tests.factories.traffic import agent, lane, random_traffic, scene

SCENES = [random_traffic(seed) for seed in range(4, 12)]  # the last has what the others lack


def save_worlds(folder: Path) -> Path:
    """A folder with one batch of five scenes of ``SCENES`` and three single ones."""
    folder.mkdir()
    save_npz(stack(SCENES[:5]), folder / "a.npz")
    for k, one in enumerate(SCENES[5:]):
        save_npz(one, folder / f"b{k}.npz")
    return folder


def save_batch(folder: Path, scenes: Sequence[Scene] = SCENES) -> Path:
    """A folder with one file of all scenes."""
    folder.mkdir()
    save_npz(stack(list(scenes)), folder / "scenes.npz")
    return folder


def evaluation_config(worlds: Path, variant: str = "baselines", **fields: Any) -> ConfigDict:
    """A config whose references and retrieval set are ``worlds``: one process, no pictures, few draws."""
    config = get_config(variant)
    config.reference = config.retrieval_set = f"npz:{worlds}"
    config.workers, config.bootstrap, config.side_by_side, config.gallery = 0, 5, 1, 1
    config.pictures, config.novelty = False, 0
    config.update(fields)
    return config


def evaluate_tables(config: ConfigDict, workdir: Path, functions: ModelFunctions | None = None) -> dict[str, Any]:
    """Runs an evaluation and returns the tables of report.json."""
    run_evaluation(config, workdir, functions)
    return read_report(workdir)["tables"]


def read_report(workdir: Path) -> dict[str, Any]:
    """The content of report.json."""
    return json.loads((workdir / "report.json").read_text())


@dataclasses.dataclass
class RoadModel:
    """Model functions without a network: samples are a road with the requested number of agents.

    Attributes:
      model: what ``load`` returns for every folder.
      conditions: of all samples so far.
      options: of all calls of ``sample`` so far.
    """

    model: Model = dataclasses.field(
        default_factory=lambda: Model(components={}, codec=scjax(), latents=LatentStatistics.identity(), domains=())
    )
    conditions: list[Condition] = dataclasses.field(default_factory=list)
    options: list[SamplingOptions] = dataclasses.field(default_factory=list)

    @property
    def functions(self) -> ModelFunctions:
        return ModelFunctions(
            load=lambda folder: self.model, sample=self._sample, reconstruct=lambda model, scenes: list(scenes)
        )

    def _sample(self, key, conditions: Sequence[Condition], *, model: Model, options: SamplingOptions) -> list[Scene]:
        self.conditions += conditions
        self.options.append(options)
        road = [lane((-30, 0), (30, 0))]
        return [scene([agent(6.0 * k, 0, 0, 5) for k in range(one.num_agents or 2)], road) for one in conditions]
