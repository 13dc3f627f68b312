"""Outlines of the forward windows of a training, with the map from its pictures to them."""

from __future__ import annotations

import jax
import numpy as np

from scjax.data import records
from scjax.data.loader import Bucket, clip_counts
from scjax.data.token_order import sort_tokens
from scjax.data.window_images import WindowImages
from scjax.generate.view_outlines import ViewOutlines, picture_features
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import LANE_DIGITS, agent_digits, scene_kinds
from scjax.scene import Crop, pad, stack

_MOST = 6000  # outlines of a model: 3 MB
_BATCH = 100


def views_of_records(folder: str, images: WindowImages, codec: SceneCodec, bucket: Bucket) -> ViewOutlines:
    """Outlines of the forward windows of the training split, fitted to their pictures."""
    stored = records.open_records(folder, "train")
    kinds_of = jax.jit(lambda scenes: scene_kinds(scenes, codec))
    lanes, agents, domains, pictures = [], [], [], []
    for start in range(0, len(stored), _BATCH):
        scenes = []
        for row in range(start, min(start + _BATCH, len(stored))):
            record = records.read_record(stored, row)
            scene = sort_tokens(clip_counts(codec.select(records.sample_scene(record, Crop.FORWARD)), bucket))[0]
            scenes.append(pad(scene, *bucket))
            tokens = images(scene, row).image
            pictures.append(picture_features(tokens.reshape(len(tokens), -1).T, images.grid))
            domains.append(int(scene.domain))
        missing = [scenes[-1]] * (_BATCH - len(scenes))  # one program for all batches
        kinds = jax.device_get(kinds_of(stack(scenes + missing)))
        lanes.append(kinds.lanes[: len(scenes)])
        agents.append(kinds.agents[: len(scenes)])
    sizes = LANE_DIGITS, agent_digits(codec)
    return ViewOutlines.fit(
        np.concatenate(lanes), np.concatenate(agents), np.array(domains), np.stack(pictures), sizes, _MOST
    )
