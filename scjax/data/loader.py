"""Record shards -> batches of scenes: pose jitter, crop, token order, buckets of padded shapes, exact resume.

Every training example is a pure function of (seed, index): which record, which jitter, crop, order and text. So the
whole state of the stream is one index and, per bucket, the indices of the examples that wait for a full batch.
"""

from __future__ import annotations

import collections
import concurrent.futures
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, cast

import grain
import numpy as np
from jaxtyping import Bool, Float

from scjax.camera.raycast import CLASSES, GRID, SemanticDepth, render
from scjax.data import records
from scjax.data import token_order as ordering
from scjax.data.caption_features import TextStore
from scjax.models.codec import SceneCodec
from scjax.scene import AnyArray, Crop, Scene, permute, stack
from scjax.scene.pytree import Replaceable, pytree

Bucket = tuple[int, int]  # (agent slots, lane slots)


@pytree
class Example(Replaceable):
    """One training example, or a batch of them.

    Attributes:
      scene: in the pipeline's layout and order.
      tokens, token_mask: features of a caption of the scene, or None; no token is valid where there is no caption.
      image, depth: semantic classes and depth ahead of the ego (``render``), or None; zeros where ``has_image`` is
        False, i.e. in windows that do not lie ahead.
    """

    scene: Scene
    tokens: Float[AnyArray, "*b slots width"] | None = None
    token_mask: Bool[AnyArray, "*b slots"] | None = None
    image: Float[AnyArray, "*b classes rows columns"] | None = None
    depth: Float[AnyArray, "*b rows columns"] | None = None
    has_image: Bool[AnyArray, "*b"] | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class PipelineConfig:
    """What a stream of training batches looks like.

    Attributes:
      batch_size: scenes a batch, over all processes.
      buckets: (agent slots, lane slots) of the padded shapes, smallest first; all scenes of a batch share one.
      crops: relative frequency of the centred, partitioned and forward crop.
      jitter_position: the crop's pose is moved by up to this many metres along x and y.
      jitter_heading: and turned by up to this many degrees.
      order: "shuffle" permutes all but the ego (autoencoder), "recursive" sorts (denoiser; official-spec §3).
      text_slots: tokens of a caption at most; the rest is cut off.
      seed: of everything random in the stream.
      workers: threads that prepare examples ahead.
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

    def __post_init__(self):
        if self.batch_size < 1:
            raise ValueError(f"batch_size must be at least 1, not {self.batch_size}")
        if not self.buckets or list(self.buckets) != sorted(self.buckets):
            raise ValueError(f"buckets must be (agents, lanes) pairs, smallest first, not {self.buckets}")
        if len(self.crops) != len(Crop) or min(self.crops) < 0 or sum(self.crops) <= 0:
            raise ValueError(f"layouts must be three frequencies of positive sum, not {self.crops}")
        if self.order not in ("shuffle", "recursive"):
            raise ValueError(f'order must be "shuffle" or "recursive", not {self.order!r}')


class BatchLoader(Iterator[Example]):
    """Endless batches [batch_size, ...] of one bucket each; ``state`` and ``restore`` resume to the very next batch.

    ``example`` maps an index to a single example of an unpadded scene and must be pure; threads prepare them ahead.
    """

    def __init__(self, example: Callable[[int], Example], config: PipelineConfig, *, processes: int = 1):
        self._example = example
        self._batch_size = config.batch_size // processes
        if config.batch_size % processes:
            raise ValueError(f"batch_size {config.batch_size} does not divide over {processes} processes")
        # Processes would have to agree on the bucket of every step: with several of them only the largest is used.
        self._buckets = config.buckets if processes == 1 else config.buckets[-1:]
        self._pool = concurrent.futures.ThreadPoolExecutor(config.workers)
        self._ahead = 2 * self._batch_size
        self._start(0, {})

    def state(self) -> dict[str, Any]:
        """JSON-serialisable state after the last batch."""
        waiting = {str(bucket): [index for index, _ in queue] for bucket, queue in enumerate(self._waiting)}
        return {"next": self._next, "waiting": waiting}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues after the batch at which ``state`` was taken."""
        self._start(int(state["next"]), state["waiting"])

    def __next__(self) -> Example:
        while True:
            index, example = self._next, self._futures.popleft().result()
            self._next += 1
            self._futures.append(self._pool.submit(self._example, self._next + len(self._futures)))
            bucket = bucket_of(example.scene, self._buckets)
            queue = self._waiting[bucket]
            queue.append((index, example))
            if len(queue) == self._batch_size:
                batch = batch_of([ready for _, ready in queue], self._buckets[bucket])
                queue.clear()
                return batch

    def _start(self, first: int, waiting: dict[str, list[int]]) -> None:
        self._next = first
        self._waiting: list[list[tuple[int, Example]]] = [
            [(index, self._example(index)) for index in waiting.get(str(bucket), [])]
            for bucket in range(len(self._buckets))
        ]
        self._futures = collections.deque(
            self._pool.submit(self._example, first + offset) for offset in range(self._ahead)
        )


def captioned(scene: Scene, features: Float[np.ndarray, "tokens width"], slots: int) -> Example:
    """A scene with the features of a caption, padded with zeros to ``slots`` tokens or cut there."""
    features = features[:slots]
    tokens = np.zeros((slots, features.shape[1]), np.float16)
    tokens[: len(features)] = features
    return Example(scene=scene, tokens=tokens, token_mask=np.arange(slots) < len(features))


def pictured(scene: Scene) -> Example:
    """A scene with the stand-in for its image, if its window lies ahead of the ego."""
    if int(scene.crop) == Crop.FORWARD:
        return Example(scene=scene, **render(scene)._asdict(), has_image=np.asarray(True))
    none = SemanticDepth(np.zeros((len(CLASSES), *GRID), np.float32), np.zeros(GRID, np.float32))
    return Example(scene=scene, **none._asdict(), has_image=np.asarray(False))


def batch_of(examples: Sequence[Example], bucket: Bucket) -> Example:
    """Examples, padded to ``bucket``, as one batch; all of them have a caption, or all an image, or none has."""
    names = ("tokens", "token_mask", "image", "depth", "has_image")
    features = {
        name: np.stack([getattr(example, name) for example in examples])
        for name in names
        if getattr(examples[0], name) is not None
    }
    return Example(scene=stack([example.scene for example in examples], bucket), **features)


def bucket_of(scene: Scene, buckets: tuple[Bucket, ...]) -> int:
    """Index of the first bucket that holds ``scene``.

    Raises:
      ValueError: if none does.
    """
    agents, lanes = scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]
    for index, (agent_slots, lane_slots) in enumerate(buckets):
        if agents <= agent_slots and lanes <= lane_slots:
            return index
    raise ValueError(
        f"a scene of {agents} agents and {lanes} lanes fits no bucket of {buckets}: make the last bucket larger"
    )


def training_batches(
    folder: str | Path, codec: SceneCodec, config: PipelineConfig, *, texts: TextStore | None = None,
    images: bool = False, process: int = 0, processes: int = 1,
) -> BatchLoader:  # fmt: skip
    """Endless augmented batches of the training split in ``folder`` (made by ``python -m scjax.data build``).

    Args:
      texts: captions of that split, of which every example gets one. They describe the centred window, so that the
        forward one goes without.
      images: whether examples carry the stand-in for an image, seen from where the window's jittered pose is.

    Raises:
      ValueError: the texts are not those of the records, texts and images are both wanted, or images of windows none of
        which lies ahead.
    """
    if images and texts is not None:
        raise ValueError("a network reads texts or images: leave one of them out")
    if images and not config.crops[Crop.FORWARD]:
        raise ValueError(
            f"images show what lies ahead, but of layouts {config.crops} the forward one, the last, never occurs: "
            "give it a frequency, as in (0, 0, 1)"
        )
    held = records.open_records(folder, "train")
    if texts is not None and len(texts) != len(held):
        raise ValueError(f"{folder}: {len(texts)} captions for {len(held)} records: caption and embed them again")
    source = grain.MapDataset.source(_Numbered(held))
    stream = source.seed(config.seed).shuffle().repeat(None)[process::processes]
    frequencies = np.cumsum(config.crops) / np.sum(config.crops)

    def augment(item: tuple[int, bytes], rng: np.random.Generator) -> Example:
        number, data = item
        crop = Crop(int(np.searchsorted(frequencies, rng.random(), side="right")))
        dx, dy = rng.uniform(-1, 1, 2) * config.jitter_position
        turn = np.deg2rad(rng.uniform(-1, 1) * config.jitter_heading)
        scene = records.sample_scene(records.decode_record(data), crop, dx, dy, turn)
        scene = clip_counts(codec.select(scene), config.buckets[-1])
        scene = shuffle(scene, rng) if config.order == "shuffle" else ordering.sort_tokens(scene)[0]
        if images:
            return pictured(scene)
        if texts is None:
            return Example(scene=scene)
        if crop == Crop.FORWARD:
            return captioned(scene, np.zeros((0, texts.width), np.float16), config.text_slots)
        return captioned(scene, texts.features(int(rng.choice(texts.texts_of(number)))), config.text_slots)

    examples = stream.random_map(augment)
    return BatchLoader(lambda index: cast(Example, examples[index]), config, processes=processes)


class _Numbered:
    """A source whose items know their place."""

    def __init__(self, source: Any):
        self._source = source

    def __len__(self) -> int:
        return len(self._source)

    def __getitem__(self, index: int) -> tuple[int, bytes]:
        return index, self._source[index]


def validation_scenes(
    folder: str | Path, codec: SceneCodec, *, crop: Crop = Crop.CENTERED, split: str = "val",
    bucket: Bucket = (61, 100),
) -> list[Scene]:  # fmt: skip
    """Every record of a split once, without jitter, unpadded, in file order, tokens in recursive order."""
    scenes = []
    for data in records.open_records(folder, split):
        scene = codec.select(records.sample_scene(records.decode_record(data), crop, 0.0, 0.0, 0.0))
        scenes.append(ordering.sort_tokens(clip_counts(scene, bucket))[0])
    return scenes


def shuffle(scene: Scene, rng: np.random.Generator) -> Scene:
    """One unpadded NumPy scene with its tokens permuted at random; the ego stays agent 0."""
    agents, lanes = scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]
    return permute(scene, np.concatenate([[0], 1 + rng.permutation(agents - 1)]), rng.permutation(lanes))


def clip_counts(scene: Scene, bucket: Bucket) -> Scene:
    """At most the bucket's numbers of agents and lanes; crops store the nearest first, so the farthest go."""
    agents, lanes = scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]
    if agents <= bucket[0] and lanes <= bucket[1]:
        return scene
    return permute(scene, np.arange(min(agents, bucket[0])), np.arange(min(lanes, bucket[1])))
