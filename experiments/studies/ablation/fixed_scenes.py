"""Trainings on windows that are the same in every epoch: they are encoded once, before the first step.

Pictures show one pose of the ego, so their windows are not moved. To read, cut and encode a window takes as long as
half a step of networks as small as the ablation's. Here all runs share the latents and features of the training split,
in memory. Steps draw the latents' noise, noise levels and dropouts as ``DenoiserObjective`` does.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer

from scjax.data import records
from scjax.data.loader import LoaderConfig, clip_counts
from scjax.data.token_order import sort_tokens
from scjax.diffusion.loss import LatentBatch
from scjax.models.autoencoder.model import autoencoder
from scjax.models.autoencoder.outputs import Posterior, reparameterize
from scjax.models.denoiser.context import ImageFeatures
from scjax.nn import random
from scjax.nn.functional import Params
from scjax.scene import AnyArray, Crop, stack
from scjax.scene.per_type import PerType
from scjax.scene.pytree import Replaceable, pytree
from scjax.train.objectives.base import Terms
from scjax.train.objectives.denoiser import DenoiserObjective
from scjax.train.objectives.known_elements import KnownShares
from scjax.train.resume import model_hash

_BATCH = 16  # windows that are encoded at once


@pytree
class EncodedWindows(Replaceable):
    """Forward windows as the denoiser trains on them.

    Attributes:
      posterior: of the autoencoder; masks: True at real tokens.
      crop, domain: of the scenes.
      index: numbers of the rows in the stream of a training, or of the records.
      image, image_mask: features of pictures in float16, and which cells are real; None without pictures.
    """

    posterior: Posterior
    masks: PerType
    crop: Int[AnyArray, " b"]
    domain: Int[AnyArray, " b"]
    index: Integer[AnyArray, " b"]
    image: Float[AnyArray, "b channels rows columns"] | None = None
    image_mask: Bool[AnyArray, "b cells_of_both"] | None = None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FixedScenesObjective(DenoiserObjective):
    """A denoiser objective with batches of its own: encoded windows, shuffled anew in every epoch.

    Raises:
      ValueError: windows that change from epoch to epoch, several padded sizes, depth, or what is not encoded here.
    """

    def __post_init__(self):
        loader = self.loader
        if loader.jitter_position or loader.jitter_heading or loader.crops[:2] != (0.0, 0.0):
            raise ValueError("fixed scenes are forward windows without jitter: set batch.crops and batch.jitter_* so")
        if len(loader.buckets) != 1 or loader.order != "recursive":
            raise ValueError("fixed scenes have one padded size and the recursive order: set batch.buckets and .order")
        if self.options.known != KnownShares(0.0, 0.0) or self.penalties:
            raise ValueError("fixed scenes have no known elements and no penalties: set these fields of loss to 0")
        if self.texts is not None or self.measurements is not None or self.ahead is not None:
            raise ValueError("fixed scenes come with pictures or with nothing: give no captions and no attributes")
        if getattr(self.model.condition, "depth", False):
            raise ValueError("fixed scenes come without depth: set image_depth to False")

    @property
    def windows(self) -> EncodedWindows:
        """All of the training split."""
        encoder = "" if self.images is None else self.images.encoder
        coder = model_hash(self.base, "autoencoder")
        source = WindowSource(self.manifest["hash"], coder, self.loader.buckets[0], encoder, self)
        return encoded_windows(source)

    def batches(self, loader: LoaderConfig, *, process: int = 0, processes: int = 1) -> WindowBatches:
        """The batches of a single process.

        Raises:
          ValueError: there are several.
        """
        if processes != 1:
            raise ValueError("fixed scenes are for trainings in one process")
        return WindowBatches(self.windows, loader.batch_size, loader.seed)

    def loss(self, params: Params, batch: EncodedWindows, keys: Array) -> tuple[Array, Terms]:
        """The denoising loss, as of ``DenoiserObjective``."""
        latents = reparameterize(random.fold_in(random.fold_in(keys, 0), 0), batch.posterior)
        features = None
        if batch.image is not None:
            image = jax.numpy.asarray(batch.image, jax.numpy.float32)
            features = ImageFeatures(dino=image, depth=image[:, 0], mask=batch.image_mask)
        latent_batch = LatentBatch(
            latents=self.base.latents.normalize(latents),
            masks=batch.masks,
            known=jax.tree.map(jax.numpy.zeros_like, batch.masks),
            label=jax.numpy.asarray(self.model.domains * batch.crop + batch.domain),
            condition=features,
        )
        return self.loss_of_latents(params, latent_batch, random.fold_in(keys, 1))


class WindowBatches(Iterator[EncodedWindows]):
    """Endless batches; batch k depends on the seed and k alone.

    Raises:
      ValueError: there are fewer windows than rows of a batch.
    """

    def __init__(self, windows: EncodedWindows, batch_size: int, seed: int):
        self._windows, self._size, self._seed = windows, batch_size, seed
        self._per_epoch = len(windows.index) // batch_size
        if not self._per_epoch:
            raise ValueError(f"{len(windows.index)} records are fewer than a batch of {batch_size}: make more")
        self._next, self._epoch, self._order = 0, -1, np.zeros(0, int)

    def state(self) -> dict[str, Any]:
        """The number of the next batch."""
        return {"next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues after the batch at which ``state`` was taken."""
        self._next = int(state["next"])

    def __next__(self) -> EncodedWindows:
        epoch, place = divmod(self._next, self._per_epoch)
        if epoch != self._epoch:
            rng = np.random.default_rng([self._seed, epoch])
            self._epoch, self._order = epoch, rng.permutation(len(self._windows.index))
        rows = self._order[place * self._size : (place + 1) * self._size]
        numbers = np.arange(self._next * self._size, (self._next + 1) * self._size, dtype=np.uint32)
        self._next += 1
        return jax.tree.map(lambda x: x[rows], self._windows).replace(index=numbers)


@dataclasses.dataclass(frozen=True)
class WindowSource:
    """What encoded windows depend on.

    Attributes:
      records, autoencoder: hashes of both.
      bucket: (agents, lanes) that windows are padded to; the farthest elements beyond are left out.
      encoder: name of the features of pictures; "": without pictures.
      objective: that reads all of these.
    """

    records: str
    autoencoder: str
    bucket: tuple[int, int]
    encoder: str
    objective: FixedScenesObjective = dataclasses.field(compare=False)


@functools.lru_cache(maxsize=2)
def encoded_windows(source: WindowSource) -> EncodedWindows:
    """The forward windows of the training split; runs with equal sources share them."""
    base, images, bucket = source.objective.base, source.objective.images, source.bucket
    stored, codec, config = records.open_records(source.objective.records, "train"), base.codec, base.autoencoder.config

    @jax.jit
    def encode(params, scenes):
        tokens = codec.normalize(scenes)
        posterior = autoencoder(config).apply(params, tokens, method="encode")
        return posterior, PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask), tokens.crop, tokens.domain

    parts, pictures = [], []
    for start in range(0, len(stored), _BATCH):
        rows = range(start, min(start + _BATCH, len(stored)))
        scenes = [records.sample_scene(records.read_record(stored, row), Crop.FORWARD) for row in rows]
        scenes = [sort_tokens(clip_counts(codec.select(scene), bucket))[0] for scene in scenes]
        seen = [] if images is None else [images(scene, row) for scene, row in zip(scenes, rows, strict=True)]
        pictures += [(one.image.astype(np.float16), one.mask) for one in seen]
        batch = stack(scenes + [scenes[0]] * (_BATCH - len(scenes)), bucket)  # one program
        whole = jax.device_get(encode(base.autoencoder.params, batch))
        parts.append(jax.tree.map(lambda x: np.asarray(x)[: len(scenes)], whole))  # noqa: B023 - used here
    posterior, masks, crop, domain = jax.tree.map(lambda *x: np.concatenate(x), *parts)
    image, image_mask = (np.stack(part) for part in zip(*pictures, strict=True)) if pictures else (None, None)
    return EncodedWindows(
        posterior=posterior,
        masks=masks,
        crop=crop,
        domain=domain,
        index=np.arange(len(crop)),
        image=image,
        image_mask=image_mask,
    )
