"""Outlines of the training's scenes, which go with a denoiser that reads kinds."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

from scjax.data import records
from scjax.data.loader import Bucket, clip_counts
from scjax.data.measurements import MeasuredRecords
from scjax.data.token_order import known_half, sort_tokens
from scjax.generate.continuations import Continuations, seam_crossings
from scjax.generate.outlines import Outlines
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import scene_kinds
from scjax.scene import Crop, Scene, pad, permute, stack, unpadded
from scjax.scene.per_type import PerType

_MOST = 8000  # outlines of a model: 4 MB
_BATCH = 100


def outlines_of_records(folder: str, measured: MeasuredRecords, codec: SceneCodec, bucket: Bucket) -> Outlines:
    """Outlines of the centered training scenes of a folder, or of 8,000 spread over it, cut to ``bucket``."""
    stored = records.open_records(folder, "train")
    rows = outline_rows(len(stored))
    kinds_of = jax.jit(lambda scenes: scene_kinds(scenes, codec))
    kinds, ahead, domains = [], [], []
    for start in range(0, len(rows), _BATCH):
        scenes = [_padded_scene(stored, row, codec, bucket) for row in rows[start : start + _BATCH]]
        domains += [int(scene.domain) for scene in scenes]
        missing = [scenes[-1]] * (_BATCH - len(scenes))  # one program for all batches
        kinds.append(jax.device_get(kinds_of(stack(scenes + missing))))
        halves = [_padded_scene(stored, row, codec, bucket, Crop.PARTITIONED) for row in rows[start : start + _BATCH]]
        ahead += _beyond(halves, jax.device_get(kinds_of(stack(halves + [halves[-1]] * (_BATCH - len(halves))))))
    return Outlines.of_scenes(
        np.concatenate([one.lanes for one in kinds])[: len(rows)],
        np.concatenate([one.agents for one in kinds])[: len(rows)],
        np.array(domains),
        [measured[row] for row in rows],
        Continuations.of_scenes(*(list(column) for column in zip(*ahead, strict=True))),
    )


def outline_rows(number: int) -> list[int]:
    """The records whose scenes give outlines, of so many in a folder."""
    return np.unique(np.linspace(0, number - 1, min(number, _MOST)).astype(int)).tolist()


def _beyond(scenes: Sequence[Scene], kinds: PerType) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Kinds of lanes and agents beyond the seam, and the lanes that cross it, of every partitioned scene."""
    result = []
    for row, padded_scene in enumerate(scenes):
        scene = unpadded(padded_scene)
        known = known_half(np.asarray(scene.lanes)[..., :2], np.asarray(scene.agents)[..., :2])
        known.agents[:1] = True
        lanes, agents = (
            np.asarray(getattr(kinds, name)[row])[: len(getattr(known, name))] for name in ("lanes", "agents")
        )
        seam = seam_crossings(permute(scene, np.flatnonzero(known.agents), np.flatnonzero(known.lanes)))
        result.append((lanes[~known.lanes], agents[~known.agents], seam))
    return result


def _padded_scene(
    stored: records.RecordShards, row: int, codec: SceneCodec, bucket: Bucket, crop: Crop = Crop.CENTERED
) -> Scene:
    scene = codec.select(records.sample_scene(records.read_record(stored, row), crop))
    return pad(sort_tokens(clip_counts(scene, bucket))[0], *bucket)
