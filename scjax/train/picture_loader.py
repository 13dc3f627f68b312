"""Endless batches of rendered dashcam pictures with targets of their cells, for the training of a vision network."""

from __future__ import annotations

import concurrent.futures
import dataclasses
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Integer, UInt8

from scjax.camera.dashcam.cell_targets import CellTargets
from scjax.camera.photo import BACKGROUND
from scjax.encoders.preprocessing import DEVIATION, MEAN
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.synthetic.pictures import read_rendered

_PLANNED = 3  # batches that are read while a step runs
_LEAST_SEEN = 0.55  # share of the height and of the width
_Y, _SINE, _LEFT = 1, 3, 4  # columns of objects and lanes that change their sign in a mirror


@pytree
class PictureExample(Replaceable):
    """A picture, or a batch of them.

    Attributes:
      index: number of the example in the stream.
      pixels: as encoders expect them.
      classes, depth, objects, lanes: ``CellTargets``.
    """

    index: Integer[AnyArray, "*b"]
    pixels: Float[AnyArray, "*b height width 3"]
    classes: UInt8[AnyArray, "*b rows columns classes"]
    depth: Float[AnyArray, "*b rows columns"]
    objects: Float[AnyArray, "*b rows columns 7"]
    lanes: Float[AnyArray, "*b rows columns 6"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PictureLoaderConfig:
    """What a stream of pictures looks like.

    Attributes:
      batch_size: pictures a batch, over all processes.
      mirror: share of pictures that are mirrored.
      brightness, tint: standard deviations of the logarithms of a picture's gain, and of those of its channels.
      cut: share of pictures of which only a part is seen, as in standard views of cameras that see less.
      seed: of everything random in the stream.
    """

    batch_size: int = 16
    mirror: float = 0.5
    brightness: float = 0.2
    tint: float = 0.05
    cut: float = 0.3
    seed: int = 0


class PictureLoader(Iterator[PictureExample]):
    """Endless batches; ``state`` and ``restore`` resume to the very next one.

    Args:
      folder: of ``synthetic.pictures.render_records``.
      split: of the records; config: what batches look like.
      process, processes: number of this process, and of all; it gets every so many rows of a batch.

    Raises:
      ValueError: there are no pictures, or the batch does not divide over the processes.
    """

    def __init__(
        self, folder: str | Path, split: str, config: PictureLoaderConfig, *, process: int = 0, processes: int = 1
    ):
        if config.batch_size % processes:
            raise ValueError(f"batch_size {config.batch_size} does not divide over {processes} processes")
        self._folder, self._split, self._config = Path(folder), split, config
        self._rows = picture_rows(folder, split)
        self._place = process, processes
        self._pool = concurrent.futures.ThreadPoolExecutor(1)
        self.restore({"next": 0})

    def __len__(self) -> int:
        """Number of different pictures."""
        return len(self._rows)

    def state(self) -> dict[str, Any]:
        """JSON-serializable state after the last batch."""
        return {"next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues after the batch at which ``state`` was taken."""
        self._next = int(state["next"])
        self._planned: deque[Future[PictureExample]] = deque()

    def __next__(self) -> PictureExample:
        size = self._config.batch_size
        while len(self._planned) < _PLANNED:
            start = self._next + len(self._planned) * size
            self._planned.append(self._pool.submit(self._batch, start))
        batch = self._planned.popleft().result()
        self._next += size
        return batch

    def _batch(self, start: int) -> PictureExample:
        process, processes = self._place
        numbers = range(start + process, start + self._config.batch_size, processes)
        return jax.tree.map(lambda *rows: np.stack(rows), *[self.example(number) for number in numbers])

    def example(self, index: int) -> PictureExample:
        """The example of this number in the stream."""
        epoch, place = divmod(index, len(self._rows))
        config = self._config
        order = np.random.default_rng([config.seed, epoch]).permutation(len(self._rows))
        rng = np.random.default_rng([config.seed, index, 1])
        pixels, targets = read_rendered(self._folder, self._split, self._rows[order[place]])
        gains = np.exp(rng.normal(0, config.brightness) + rng.normal(0, config.tint, 3))
        if rng.random() < config.mirror:
            pixels, targets = mirrored(pixels, targets)
        pixels = pixels * gains.astype(np.float32)
        if rng.random() < config.cut:
            pixels, targets = cut_picture(pixels, targets, rng)
        return picture_example(index, pixels, targets)


def picture_rows(folder: str | Path, split: str) -> list[int]:
    """Rows of the records of a split that have pictures.

    Raises:
      ValueError: there are none.
    """
    rows = sorted(int(path.stem.rsplit("-", 1)[1]) for path in Path(folder).glob(f"{split}-*.npz"))
    if not rows:
        raise ValueError(f"{folder} holds no pictures of the split {split}: make them with scjax data dashcam")
    return rows


def picture_example(index: int, pixels: np.ndarray, targets: CellTargets) -> PictureExample:
    """The example of a picture of 0..255."""
    normalized = (pixels.astype(np.float32).clip(0, 255) / 255 - np.array(MEAN)) / np.array(DEVIATION)
    return PictureExample(
        index=np.asarray(index, np.uint32),
        pixels=normalized.astype(np.float32),
        classes=targets.classes,
        depth=targets.depth.astype(np.float32),
        objects=targets.objects.astype(np.float32),
        lanes=targets.lanes.astype(np.float32),
    )


def mirrored(pixels: np.ndarray, targets: CellTargets) -> tuple[np.ndarray, CellTargets]:
    """The picture in a mirror, with its targets."""
    objects, lanes = targets.objects[:, ::-1].copy(), targets.lanes[:, ::-1].copy()
    objects[..., [_Y, _SINE]] *= -1
    lanes[..., [_Y, _SINE, _LEFT]] *= -1
    return pixels[:, ::-1], CellTargets(targets.classes[:, ::-1], targets.depth[:, ::-1], objects, lanes)


def cut_picture(pixels: np.ndarray, targets: CellTargets, rng: np.random.Generator) -> tuple[np.ndarray, CellTargets]:
    """The picture with ``BACKGROUND`` around a part of it; cells whose middles are cut show no object and no lane."""
    cells = np.array(targets.depth.shape)
    extent = rng.uniform(_LEAST_SEEN, 1.0, 2)
    low = rng.uniform(0, 1 - extent)
    middles = [(np.arange(count) + 0.5) / count for count in (*pixels.shape[:2], *cells)]
    seen = [(at > low[axis % 2]) & (at < (low + extent)[axis % 2]) for axis, at in enumerate(middles)]
    shown = (seen[2][:, None] & seen[3])[..., None]
    pixels = np.where((seen[0][:, None] & seen[1])[..., None], pixels, np.array(BACKGROUND, pixels.dtype))
    return pixels, targets._replace(
        objects=np.where(shown, targets.objects, 0).astype(targets.objects.dtype),
        lanes=np.where(shown, targets.lanes, 0).astype(targets.lanes.dtype),
    )
