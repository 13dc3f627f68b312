"""Outlines of the training's scenes, which go with a denoiser that reads kinds."""

from __future__ import annotations

import jax
import numpy as np

from scjax.data import records
from scjax.data.loader import Bucket, clip_counts
from scjax.data.measurements import MeasuredRecords
from scjax.data.token_order import sort_tokens
from scjax.generate.outlines import Outlines
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import agent_kinds, lane_kinds
from scjax.scene import Scene, pad, stack
from scjax.scene.per_type import PerType

_MOST = 8000  # outlines of a model: 4 MB
_BATCH = 100


def scene_kinds(scene: Scene, codec: SceneCodec) -> PerType:
    """The kinds of all tokens of scenes in meters."""
    return PerType(agents=agent_kinds(scene, codec), lanes=lane_kinds(scene))


def outlines_of_records(folder: str, measured: MeasuredRecords, codec: SceneCodec, bucket: Bucket) -> Outlines:
    """Outlines of the centered training scenes of a folder, or of 8,000 spread over it, cut to ``bucket``."""
    stored = records.open_records(folder, "train")
    rows = outline_rows(len(stored))
    kinds_of = jax.jit(lambda scenes: scene_kinds(scenes, codec))
    kinds, domains = [], []
    for start in range(0, len(rows), _BATCH):
        scenes = [_padded_scene(stored, row, codec, bucket) for row in rows[start : start + _BATCH]]
        domains += [int(scene.domain) for scene in scenes]
        missing = [scenes[-1]] * (_BATCH - len(scenes))  # one program for all batches
        kinds.append(jax.device_get(kinds_of(stack(scenes + missing))))
    return Outlines.of_scenes(
        np.concatenate([one.lanes for one in kinds])[: len(rows)],
        np.concatenate([one.agents for one in kinds])[: len(rows)],
        np.array(domains),
        [measured[row] for row in rows],
    )


def outline_rows(number: int) -> list[int]:
    """The records whose scenes give outlines, of so many in a folder."""
    return np.unique(np.linspace(0, number - 1, min(number, _MOST)).astype(int)).tolist()


def _padded_scene(stored: records.RecordShards, row: int, codec: SceneCodec, bucket: Bucket) -> Scene:
    scene = codec.select(records.sample_scene(records.read_record(stored, row)))
    return pad(sort_tokens(clip_counts(scene, bucket))[0], *bucket)
