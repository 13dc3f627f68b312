"""Record shards -> batches of scenes: pose jitter, crop, token order, buckets of padded shapes, exact resume.

Every training example is a pure function of (seed, index): record, jitter, crop, order and caption. Examples wait in
the queue of their bucket until it holds a batch. So the bucket of a step and the rows of its batch are functions of
(seed, step) and the records; all processes agree on them, and each prepares its share of the rows. The state of the
stream is the next index and the indices that wait.
"""

from __future__ import annotations

import collections
import concurrent.futures
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple, cast

import grain
import numpy as np
from jaxtyping import Bool, Float, Integer

from scjax.data import records
from scjax.data.caption_features import TextStore
from scjax.data.loader_config import Bucket, LoaderConfig
from scjax.data.measurements import MeasuredRecords
from scjax.data.token_order import sort_tokens
from scjax.data.window_images import CameraTokens, WindowImages
from scjax.language.attributes.draw import draw_attributes
from scjax.language.attributes.vector import feature_names, request_vector
from scjax.models.codec import SceneCodec
from scjax.scene import AnyArray, Crop, Scene, permute, stack
from scjax.scene.pytree import Replaceable, pytree

_PLANNED = 2  # batches that are under way while a step runs


@pytree
class TrainingExample(Replaceable):
    """One training example, or a batch of them.

    Attributes:
      scene: in the crop and token order of the stream.
      index: number of the example in the stream, from which training draws its noise; None outside of streams.
      tokens, token_mask: features of a caption of the scene, or None; no token is valid where there is no caption.
      attributes: features of a request that the scene fulfills, or None; zeros where nothing is requested.
      image, depth, image_mask: features and depth of the cells of a picture, and which cells are real, or None; zeros
        where ``has_image`` is False, i.e. in windows that are not ahead of the ego.
    """

    scene: Scene
    index: Integer[AnyArray, "*b"] | None = None
    tokens: Float[AnyArray, "*b slots width"] | None = None
    token_mask: Bool[AnyArray, "*b slots"] | None = None
    attributes: Float[AnyArray, "*b features"] | None = None
    image: Float[AnyArray, "*b channels rows columns"] | None = None
    depth: Float[AnyArray, "*b rows columns"] | None = None
    image_mask: Bool[AnyArray, "*b cells_of_both"] | None = None
    has_image: Bool[AnyArray, "*b"] | None = None


class Drawn(NamedTuple):
    """What decides an example: its unpadded scene and record, the number of its caption, and its request."""

    scene: Scene
    row: int
    caption: int | None = None
    request: dict[str, Any] | None = None


class _PlannedBatch(NamedTuple):
    """A batch under way: its rows of this process, its padded shape, and the loader's state after it."""

    rows: list[Future[TrainingExample]]
    bucket: Bucket
    state: dict[str, Any]


class BatchLoader(Iterator[TrainingExample]):
    """Endless batches of one bucket each; ``state`` and ``restore`` resume to the very next batch.

    With several processes, process p gets the rows [p::processes] of every batch. Each process draws all scenes,
    since their sizes decide the buckets, but completes its own rows only.

    Args:
      draw: index -> scene and caption; must be pure.
      complete: (index, drawn) -> training example with its features; must be pure.
      config: batch size over all processes, buckets, threads.
      process, processes: number of this process, and of all.

    Raises:
      ValueError: the batch size does not divide over the processes.
    """

    def __init__(
        self,
        draw: Callable[[int], Drawn],
        complete: Callable[[int, Drawn], TrainingExample],
        config: LoaderConfig,
        *,
        process: int = 0,
        processes: int = 1,
    ):
        if config.batch_size % processes:
            raise ValueError(f"batch_size {config.batch_size} does not divide over {processes} processes")
        self._draw, self._complete = draw, complete
        self._batch_size, self._buckets = config.batch_size, config.buckets
        self._process, self._processes = process, processes
        self._pool = concurrent.futures.ThreadPoolExecutor(config.workers)
        self.restore({"next": 0, "waiting": {}})

    def state(self) -> dict[str, Any]:
        """JSON-serializable state after the last batch: the next index, and the indices that wait in each bucket."""
        return self._state

    def restore(self, state: dict[str, Any]) -> None:
        """Continues after the batch at which ``state`` was taken."""
        self._state = state
        self._next = int(state["next"])
        self._planned: collections.deque[_PlannedBatch] = collections.deque()
        self._waiting: list[list[tuple[int, Future[TrainingExample] | None]]] = [[] for _ in self._buckets]
        for bucket, queue in enumerate(self._waiting):
            for index in state["waiting"].get(str(bucket), []):
                self._append(queue, index, self._draw(index))
        self._draws = collections.deque(
            self._pool.submit(self._draw, self._next + offset) for offset in range(2 * self._batch_size)
        )

    def __next__(self) -> TrainingExample:
        while len(self._planned) < _PLANNED:
            self._planned.append(self._plan())
        rows, bucket, self._state = self._planned.popleft()
        return batch_of([row.result() for row in rows], bucket)

    def _plan(self) -> _PlannedBatch:
        """Moves the stream on until a bucket holds a batch."""
        while True:
            index, drawn = self._next, self._draws.popleft().result()
            self._next += 1
            self._draws.append(self._pool.submit(self._draw, self._next + len(self._draws)))
            bucket = scene_bucket(drawn.scene, self._buckets)
            queue = self._waiting[bucket]
            self._append(queue, index, drawn)
            if len(queue) == self._batch_size:
                rows = [row for _, row in queue if row is not None]
                queue.clear()
                waiting = {str(b): [index for index, _ in other] for b, other in enumerate(self._waiting)}
                return _PlannedBatch(rows, self._buckets[bucket], {"next": self._next, "waiting": waiting})

    def _append(self, queue: list, index: int, drawn: Drawn) -> None:
        is_own = len(queue) % self._processes == self._process
        queue.append((index, self._pool.submit(self._complete, index, drawn) if is_own else None))


def with_caption(scene: Scene, features: Float[np.ndarray, "tokens width"], slots: int) -> TrainingExample:
    """A scene with the features of a caption, padded with zeros to ``slots`` tokens or cut there."""
    features = features[:slots]
    tokens = np.zeros((slots, features.shape[1]), np.float16)
    tokens[: len(features)] = features
    return TrainingExample(scene=scene, tokens=tokens, token_mask=np.arange(slots) < len(features))


def with_image(scene: Scene, row: int, images: WindowImages) -> TrainingExample:
    """The scene of a record with what a camera sees of it, if its window is ahead of the ego; zeros otherwise."""
    is_ahead = int(scene.crop) == Crop.FORWARD
    if is_ahead:
        tokens = images(scene, row)
    else:
        rows, columns = images.grid
        image = np.zeros((images.channels, rows, columns), np.float32)
        tokens = CameraTokens(image, np.zeros((rows, columns), np.float32), np.zeros(2 * rows * columns, bool))
    return TrainingExample(
        scene=scene, image=tokens.image, depth=tokens.depth, image_mask=tokens.mask, has_image=np.asarray(is_ahead)
    )


def batch_of(examples: Sequence[TrainingExample], bucket: Bucket) -> TrainingExample:
    """Examples, padded to ``bucket``, as one batch; all of them have a caption, or all an image, or none has."""
    names = ("index", "tokens", "token_mask", "attributes", "image", "depth", "image_mask", "has_image")
    features = {
        name: np.stack([getattr(example, name) for example in examples])
        for name in names
        if getattr(examples[0], name) is not None
    }
    return TrainingExample(scene=stack([example.scene for example in examples], bucket), **features)


def scene_bucket(scene: Scene, buckets: tuple[Bucket, ...]) -> int:
    """Position of the first bucket that holds the unpadded ``scene``.

    Raises:
      ValueError: the scene is larger than the last bucket.
    """
    agents, lanes = scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]
    for index, (agent_slots, lane_slots) in enumerate(buckets):
        if agents <= agent_slots and lanes <= lane_slots:
            return index
    raise ValueError(
        f"a scene of {agents} agents and {lanes} lanes fits no bucket of {buckets}: make the last bucket larger"
    )


def training_batches(
    folder: str | Path,
    codec: SceneCodec,
    config: LoaderConfig,
    *,
    texts: TextStore | None = None,
    measurements: MeasuredRecords | None = None,
    ahead: MeasuredRecords | None = None,
    images: WindowImages | None = None,
    process: int = 0,
    processes: int = 1,
) -> BatchLoader:
    """Endless augmented batches of the training split in ``folder`` (written by ``python -m scjax.data build``).

    Args:
      texts: captions of that split, one of which goes with every example. They describe the centered window, so the
        forward window has none.
      measurements: attributes of that split, from which a request is drawn for every example but those of the forward
        window; ahead: those of the forward windows, which get requests from them.
      images: what a camera sees in the forward windows, or None. Without pictures of any pose these are not jittered.
      process, processes: number of this process, and of all; a process gets its rows of every batch.

    Raises:
      ValueError: as ``records.open_records``, and later as ``records.read_record``; the texts are not those of the
        records, both texts and images are given, or images are given but no window is ahead of the ego.
    """
    if images is not None and texts is not None:
        raise ValueError("a network reads texts or images: leave one of them out")
    if images is not None and not config.crops[Crop.FORWARD]:
        raise ValueError(
            f"images show the forward window, but crops {config.crops} give it, the last, no frequency: "
            "give it one, as in (0, 0, 1)"
        )
    source = records.open_records(folder, "train")
    if texts is not None and len(texts) != len(source):
        raise ValueError(f"{folder}: {len(texts)} captions for {len(source)} records: caption and embed them again")
    if measurements is not None and len(measurements) != len(source):
        raise ValueError(f"{folder}: {len(measurements)} measured of {len(source)} records: measure them again")
    examples = _Examples(codec, config, texts, measurements, ahead, images)
    stream = grain.MapDataset.source(_Numbered(source)).seed(config.seed).shuffle().repeat(None)
    drawn = stream.random_map(examples.draw)
    return BatchLoader(
        lambda index: cast(Drawn, drawn[index]), examples.complete, config, process=process, processes=processes
    )


@dataclasses.dataclass(frozen=True)
class _Examples:
    """Records -> training examples; arguments as for ``training_batches``."""

    codec: SceneCodec
    config: LoaderConfig
    texts: TextStore | None
    measurements: MeasuredRecords | None
    ahead: MeasuredRecords | None
    images: WindowImages | None

    def draw(self, item: tuple[int, records.SceneRecord], rng: np.random.Generator) -> Drawn:
        """The augmented scene of a record and its number, one of its captions, and a request."""
        number, record = item
        config = self.config
        frequencies = np.cumsum(config.crops) / np.sum(config.crops)
        crop = Crop(int(np.searchsorted(frequencies, rng.random(), side="right")))
        dx, dy = rng.uniform(-1, 1, 2) * config.jitter_position
        turn = np.deg2rad(rng.uniform(-1, 1) * config.jitter_heading)
        if crop == Crop.FORWARD and self.images is not None and not self.images.any_pose:
            dx, dy, turn = 0.0, 0.0, 0.0
        scene = records.sample_scene(record, crop, dx, dy, turn)
        scene = clip_counts(self.codec.select(scene), config.buckets[-1])
        scene = shuffle(scene, rng) if config.order == "shuffle" else sort_tokens(scene)[0]
        if crop == Crop.FORWARD:
            return Drawn(scene, number, None, None if self.ahead is None else draw_attributes(self.ahead[number], rng))
        caption = None if self.texts is None else int(rng.choice(self.texts.texts_of(number)))
        request = None if self.measurements is None else draw_attributes(self.measurements[number], rng)
        return Drawn(scene, number, caption, request)

    def complete(self, index: int, drawn: Drawn) -> TrainingExample:
        """The example of a drawn scene, with its features."""
        example = self._with_features(drawn).replace(index=np.asarray(index, np.uint32))
        if self.measurements is None and self.ahead is None:
            return example
        return example.replace(attributes=request_vector(drawn.request or {}, feature_names()))

    def _with_features(self, drawn: Drawn) -> TrainingExample:
        if self.images is not None:
            return with_image(drawn.scene, drawn.row, self.images)
        if self.texts is None:
            return TrainingExample(scene=drawn.scene)
        none = np.zeros((0, self.texts.width), np.float16)
        features = none if drawn.caption is None else self.texts.features(drawn.caption)
        return with_caption(drawn.scene, features, self.texts.slots(self.config.text_slots))


class _Numbered:
    """A source of (number, record) pairs."""

    def __init__(self, source: records.RecordShards):
        self._source = source

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> tuple[int, records.SceneRecord]:
        return index, records.read_record(self._source, index)


def validation_scenes(
    folder: str | Path,
    codec: SceneCodec,
    *,
    crop: Crop = Crop.CENTERED,
    split: str = "val",
    bucket: Bucket = (61, 100),
) -> list[Scene]:
    """Every record of a split once, without jitter, unpadded, in file order, tokens in recursive order.

    Scenes larger than ``bucket`` lose their farthest agents and lanes.

    Raises:
      ValueError: as ``records.open_records`` and ``records.read_record``.
    """
    scenes = []
    stored = records.open_records(folder, split)
    for row in range(len(stored)):
        scene = codec.select(records.sample_scene(records.read_record(stored, row), crop, 0.0, 0.0, 0.0))
        scenes.append(sort_tokens(clip_counts(scene, bucket))[0])
    return scenes


def shuffle(scene: Scene, rng: np.random.Generator) -> Scene:
    """One unpadded NumPy scene with its tokens in random order; the ego stays agent 0."""
    agents, lanes = scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]
    return permute(scene, np.concatenate([[0], 1 + rng.permutation(agents - 1)]), rng.permutation(lanes))


def clip_counts(scene: Scene, bucket: Bucket) -> Scene:
    """At most the bucket's numbers of agents and lanes; crops store the nearest first, so the farthest are cut."""
    agents, lanes = scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]
    if agents <= bucket[0] and lanes <= bucket[1]:
        return scene
    return permute(scene, np.arange(min(agents, bucket[0])), np.arange(min(lanes, bucket[1])))
