"""Scenes that a model generates for references, stored in npz parts; an interrupted run continues there."""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import jax
import numpy as np
from tqdm import tqdm

from scjax.data.loader import clip_counts
from scjax.evaluate.hashing import content_hash, row_text
from scjax.evaluate.requests import RequestFunction
from scjax.evaluate.sources import LARGEST_COUNTS, NpzScenes, SceneSource
from scjax.generate.conditions import Condition
from scjax.generate.model import Model, load_model
from scjax.generate.reconstruct import reconstruct
from scjax.generate.sample import sample_scenes
from scjax.scene import Scene, stack
from scjax.scene.io import save_npz
from scjax.scene.per_type import PerType

PART_SIZE = 250  # scenes per file

Shard = tuple[int, int]
"""(i, n): every n-th part, starting at the i-th."""


@dataclasses.dataclass(frozen=True)
class SamplingOptions:
    """How a model samples.

    Attributes:
      seed: of the random keys.
      num_steps: diffusion steps; None: the sampler's default.
      guidance: guidance scale; None: the model's default.
      temperature: noise scale of agents and lanes; None: the model's default.
      energy_guidance: None: as the model does by default.
      best_of: samples per condition, of which the best is repaired and kept.
    """

    seed: int = 0
    num_steps: int | None = None
    guidance: float | None = None
    temperature: PerType | None = None
    energy_guidance: bool | None = None
    best_of: int = 1


@runtime_checkable
class SampleFunction(Protocol):
    """Samples one scene per condition."""

    def __call__(
        self, key: jax.Array, conditions: Sequence[Condition], *, model: Model, options: SamplingOptions
    ) -> list[Scene]: ...


def sample_with_options(
    key: jax.Array, conditions: Sequence[Condition], *, model: Model, options: SamplingOptions
) -> list[Scene]:
    """One scene per condition, as ``scjax.sample`` with these options."""
    return sample_scenes(
        key,
        conditions,
        model=model,
        num_steps=options.num_steps,
        guidance=options.guidance,
        best_of=options.best_of,
        repair=options.best_of > 1,
        temperature=options.temperature,
        energy_guidance=options.energy_guidance,
    )


@dataclasses.dataclass(frozen=True)
class ModelFunctions:
    """The functions of scjax.generate that an evaluation calls."""

    load: Callable[[str], Model] = load_model
    sample: SampleFunction = sample_with_options
    reconstruct: Callable[[Model, Sequence[Scene]], list[Scene]] = reconstruct


class OtherShardsPending(Exception):
    """Other shards have not finished their parts of a method yet."""


class GeneratedScenes(NpzScenes):
    """npz files with the scenes of a model, each at the location of its reference.

    Attributes:
      reconstructed_by: folder of the model whose autoencoder reconstructed the references; "" for samples.
    """

    def __init__(self, folder: Path, clusters: Sequence[str], reconstructed_by: str = ""):
        super().__init__(str(folder))
        self.reconstructed_by = reconstructed_by
        if len(clusters) != len(self.clusters):
            raise ValueError(f"{folder} holds {len(self.clusters)} scenes instead of {len(clusters)}: delete it")
        self.clusters = list(clusters)


@dataclasses.dataclass(frozen=True)
class PartFiles:
    """Where the scenes of a method are stored.

    Attributes:
      folder: path of the method's files; a hash of the content is appended.
      reference: the references.
      rows: row of the reference of every scene.
      title: of the progress bar.
      shard: which parts this call generates.
      part_size: scenes per file.
    """

    folder: Path
    reference: SceneSource
    rows: Sequence[int]
    title: str
    shard: Shard = (0, 1)
    part_size: int = PART_SIZE

    def generate(self, name: str, make_part: Callable[[Sequence[int], int], list[Scene]]) -> GeneratedScenes:
        """Generates missing parts of this shard with ``make_part(rows, part number)``.

        Raises:
          OtherShardsPending: parts of other shards are missing.
        """
        name = content_hash(name, str(self.part_size))
        folder = self.folder.with_name(f"{self.folder.name}-{name}")  # other models and seeds have their own folder
        folder.mkdir(parents=True, exist_ok=True)
        pause = 0.5 if sys.stderr.isatty() else 30.0
        starts = range(0, len(self.rows), self.part_size)
        with tqdm(total=len(self.rows), desc=self.title, unit="scene", mininterval=pause) as bar:
            for number, start in enumerate(starts):
                rows, path = self.rows[start : start + self.part_size], folder / f"part-{number:05d}.npz"
                if number % self.shard[1] == self.shard[0] and not path.exists():
                    save_npz(stack(make_part(rows, number)), path)
                bar.update(len(rows))
        if len(list(folder.glob("part-*.npz"))) < len(starts):
            raise OtherShardsPending
        every = self.reference.clusters
        return GeneratedScenes(folder, [every[int(row)] for row in self.rows])


def generate_samples(
    model: Model, files: PartFiles, request: RequestFunction, options: SamplingOptions, sample: SampleFunction
) -> GeneratedScenes:
    """One sample for every row of ``files``."""
    key = jax.random.key(options.seed)

    def make_part(rows: Sequence[int], number: int) -> list[Scene]:
        references = files.reference.read(rows)
        conditions = [request(scene, row) for scene, row in zip(references, rows, strict=True)]
        return sample(jax.random.fold_in(key, number), conditions, model=model, options=options)

    # Temperature and energy guidance are no weights, but models may differ in them alone.
    defaults = str((model.temperature, model.energy_guidance))
    name = content_hash(
        "samples",
        weights_hash(model),
        defaults,
        files.reference.fingerprint,
        row_text(files.rows),
        files.title,
        str(options),
    )
    return files.generate(name, make_part)


def generate_reconstructions(
    model: Model, files: PartFiles, reconstruct: Callable[[Model, Sequence[Scene]], list[Scene]]
) -> GeneratedScenes:
    """The autoencoder's reconstruction of every row of ``files``, from its posterior mean."""

    def make_part(rows: Sequence[int], number: int) -> list[Scene]:
        scenes = [clip_counts(model.codec.select(scene), LARGEST_COUNTS) for scene in files.reference.read(rows)]
        return reconstruct(model, scenes)

    name = content_hash("reconstructions", weights_hash(model), files.reference.fingerprint, row_text(files.rows))
    return files.generate(name, make_part)


def weights_hash(model: Model) -> str:
    """A hash of all parameters: identifies the checkpoint behind a table."""
    digest = hashlib.sha256()
    networks = [model.components[name].params for name in ("autoencoder", "denoiser") if name in model.components]
    for leaf in jax.tree.leaves(networks):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    return digest.hexdigest()[:16]
