"""Outlines of the forward windows of a training, with the map from its pictures to them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Int, UInt8

from scjax.data import records
from scjax.data.loader import Bucket, clip_counts
from scjax.data.token_order import sort_tokens
from scjax.data.window_images import WindowImages
from scjax.generate.view_outlines import ViewOutlines, picture_features
from scjax.generate.view_roads import lane_bins
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import LANE_DIGITS, agent_digits, scene_kinds
from scjax.scene import Crop, Scene, pad, stack

MOST = 6000
"""Outlines of a model: 5 MB."""

_BATCH = 100


class WindowOutlines(NamedTuple):
    """Outlines of forward windows.

    Attributes:
      lanes, agents: kinds in token order [scenes, tokens].
      domains: index of each scene's domain.
      roads: ``view_roads.lane_bins``.
    """

    lanes: Int[np.ndarray, "scenes lanes"]
    agents: Int[np.ndarray, "scenes agents"]
    domains: Int[np.ndarray, " scenes"]
    roads: UInt8[np.ndarray, "scenes bytes"]


def views_of_records(folder: str, images: WindowImages, codec: SceneCodec, bucket: Bucket) -> ViewOutlines:
    """Outlines of the forward windows of the training split, fitted to their pictures."""
    pictures = []

    def keep_features(scene: Scene, row: int) -> None:
        tokens = images(scene, row).image
        pictures.append(picture_features(tokens.reshape(len(tokens), -1).T, images.grid))

    outlines = windows_of_records(folder, codec, bucket, keep_features)
    sizes = LANE_DIGITS, agent_digits(codec)
    return ViewOutlines.fit(*outlines[:3], np.stack(pictures), sizes, MOST, outlines.roads)


def windows_of_records(
    folder: str, codec: SceneCodec, bucket: Bucket, visit: Callable[[Scene, int], None] | None = None
) -> WindowOutlines:
    """Outlines of the forward windows of the training split.

    Args:
      bucket: agents and lanes that a scene may have.
      visit: called with each padded window and its row.
    """
    stored = records.open_records(folder, "train")
    kinds_of = jax.jit(lambda scenes: scene_kinds(scenes, codec))
    lanes, agents, domains, roads = [], [], [], []
    for start in range(0, len(stored), _BATCH):
        scenes = []
        for row in range(start, min(start + _BATCH, len(stored))):
            record = records.read_record(stored, row)
            scene = sort_tokens(clip_counts(codec.select(records.sample_scene(record, Crop.FORWARD)), bucket))[0]
            scenes.append(pad(scene, *bucket))
            domains.append(int(scene.domain))
            roads.append(lane_bins(scene))
            if visit is not None:
                visit(scenes[-1], row)
        missing = [scenes[-1]] * (_BATCH - len(scenes))  # one program for all batches
        kinds = jax.device_get(kinds_of(stack(scenes + missing)))
        lanes.append(kinds.lanes[: len(scenes)])
        agents.append(kinds.agents[: len(scenes)])
    return WindowOutlines(np.concatenate(lanes), np.concatenate(agents), np.array(domains), np.stack(roads))
