"""Scenes that a model makes for references, part by part into npz files; a run that was stopped goes on there."""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from scjax.data.loader import clip_counts
from scjax.evaluate.captions import caption_of
from scjax.evaluate.sources import BUCKET, Npz, Source, digest, row_text
from scjax.generate.best_of import make as pick
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.prompts import encode_prompts
from scjax.generate.sample import reconstruct, sample_many
from scjax.scene import Scene, empty, stack
from scjax.scene.io import save_npz
from scjax.scene.per_type import PerType

CANDIDATES = 8  # for each scene of a row "picked"
PART = 250  # scenes a file

Shard = tuple[int, int]
"""(i, n): every n-th part from the i-th on."""

Ask = Callable[[Scene, int], Condition]
"""(reference, its row) -> what is asked of the model."""


@dataclasses.dataclass(frozen=True)
class Sampling:
    """How scenes are drawn: seed, diffusion steps (None: all of training); guidance weight, temperature of agents and
    of lanes, and whether samples are steered (None: as the model has it); whether the best of several candidates,
    tidied, is taken, as ``scjax generate`` does."""

    seed: int = 0
    steps: int | None = None
    guidance: float | None = None
    temperature: PerType | None = None
    energy_guidance: bool | None = None
    picked: bool = False


class Pending(Exception):
    """Other shards have not made their parts of a row yet."""


class Made(Npz):
    """npz files of a model's scenes, each at the location of its reference.

    Attributes:
      decoded_by: folder of the model whose autoencoder made them of their references; "" where they were drawn.
    """

    def __init__(self, folder: Path, clusters: Sequence[str], decoded_by: str = ""):
        super().__init__(str(folder))
        self.decoded_by = decoded_by
        if len(clusters) != len(self.clusters):
            raise ValueError(f"{folder} holds {len(self.clusters)} scenes instead of {len(clusters)}: delete it")
        self.clusters = list(clusters)


def sampled(
    model: Model,
    folder: Path,
    reference: Source,
    rows: Sequence[int],
    ask: Ask,
    how: Sampling,
    title: str,
    shard: Shard = (0, 1),
) -> Made:
    """One sample for every row of the reference, in files of a folder that is named by ``folder`` and its content."""
    key = jax.random.key(how.seed)

    def make(part: Sequence[int], number: int) -> list[Scene]:
        conditions = [ask(scene, row) for scene, row in zip(reference.read(part), part, strict=True)]
        part_key = jax.random.fold_in(key, number)
        options: dict[str, Any] = {
            "steps": how.steps,
            "guidance": how.guidance,
            "temperature": how.temperature,
            "energy_guidance": how.energy_guidance,
        }
        if not how.picked:
            return sample_many(part_key, conditions, model=model, **options)
        prompts = [condition.prompt or "" for condition in conditions]
        told = encode_prompts(conditions, model)
        return pick(part_key, prompts, told, model=model, pick=CANDIDATES, **options)

    own = str((model.temperature, model.energy_guidance))  # not among the weights, and models differ by them alone
    name = digest("sampled", weights_hash(model), own, reference.fingerprint, row_text(rows), title, str(how))
    return _in_files(folder, name, rows, reference, make, title, shard)


def decoded(
    model: Model, folder: Path, reference: Source, rows: Sequence[int], title: str, shard: Shard = (0, 1)
) -> Made:
    """The autoencoder's reconstruction of every row of the reference, from its posterior mean."""

    def make(part: Sequence[int], number: int) -> list[Scene]:
        scenes = [clip_counts(model.codec.select(scene), BUCKET) for scene in reference.read(part)]
        return reconstruct(model, scenes)

    name = digest("decoded", weights_hash(model), reference.fingerprint, row_text(rows))
    return _in_files(folder, name, rows, reference, make, title, shard)


def counts_of(model: Model, scene: Scene, domain: str | None) -> Condition:
    """A request for the numbers of lanes and agents of a scene, and its data set where the model knows that."""
    return Condition(
        num_lanes=max(len(scene.lane_mask), 1),
        num_agents=max(len(scene.agent_mask), 1),
        domain=domain if domain in model.domains else None,
    )


def nothing_of(model: Model, scene: Scene, domain: str | None) -> Condition:
    """A request for anything: counts and data set are drawn from the training data's."""
    return Condition()


def lanes_of(model: Model, scene: Scene, domain: str | None) -> Condition:
    """A request for traffic on a scene's own lanes, at its number of agents."""
    bare = empty(0, 0)
    agents = ("agents", "agent_types", "agent_mask", "agent_known")
    known = model.codec.select(scene).replace(**{name: getattr(bare, name) for name in agents})
    return dataclasses.replace(counts_of(model, scene, domain), num_lanes=len(known.lane_mask) or 1, known=known)


def prompt_of(model: Model, scene: Scene, domain: str | None) -> Condition:
    """A request by the caption of a scene; counts are the model's to find."""
    return Condition(prompt=caption_of(scene), domain=domain if domain in model.domains else None)


def weights_hash(model: Model) -> str:
    """Of all parameters: states which checkpoint made a table."""
    found = hashlib.sha256()
    networks = [model.components[name].params for name in ("autoencoder", "denoiser") if name in model.components]
    for leaf in jax.tree.leaves(networks):
        found.update(np.ascontiguousarray(leaf).tobytes())
    return found.hexdigest()[:16]


def _in_files(
    folder: Path,
    name: str,
    rows: Sequence[int],
    reference: Source,
    make: Callable[[Sequence[int], int], list[Scene]],
    title: str,
    shard: Shard,
) -> Made:
    folder = folder.with_name(f"{folder.name}-{name}")  # scenes of another model or seed stay where they are
    folder.mkdir(parents=True, exist_ok=True)
    pause = 0.5 if sys.stderr.isatty() else 30.0
    with tqdm(total=len(rows), desc=title, unit="scene", mininterval=pause) as bar:
        for number, start in enumerate(range(0, len(rows), PART)):
            part, path = rows[start : start + PART], folder / f"part-{number:05d}.npz"
            if number % shard[1] == shard[0] and not path.exists():
                save_npz(stack(make(part, number)), path)
            bar.update(len(part))
    if len(list(folder.glob("part-*.npz"))) < -(-len(rows) // PART):
        raise Pending
    every = reference.clusters
    return Made(folder, [every[int(row)] for row in rows])
