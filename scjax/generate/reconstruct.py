"""Scenes through the autoencoder alone: encoded and decoded again."""

from __future__ import annotations

from collections.abc import Sequence

from scjax.generate.batching import in_batches
from scjax.generate.compiled import decode_program, encode_program
from scjax.generate.model import Model
from scjax.scene import Scene, stack, unpadded


def reconstruct(model: Model, scenes: Sequence[Scene]) -> list[Scene]:
    """Each scene encoded and decoded from its posterior mean, unpadded, with its elements in the same order.

    Args:
      scenes: single scenes of the model's types (``model.codec.select``), so that elements match by index.

    Raises:
      ValueError: the model has no autoencoder, or a scene has more elements than the largest bucket.
    """
    coder = model.codec, model.autoencoder.config
    scenes = [scene.to_numpy() for scene in scenes]
    results: dict[int, Scene] = {}
    sizes = [(scene.agent_mask.shape[-1], scene.lane_mask.shape[-1]) for scene in scenes]
    for bucket, indices, rows in in_batches(sizes):
        padded = stack([scenes[i] for i in rows], bucket)
        params, statistics = model.autoencoder.placed_params(len(rows)), (model.latents.mean, model.latents.std)
        masks, latents = encode_program(*coder)(params, *statistics, padded)
        decoded = decode_program(*coder)(
            params["decoder"], *statistics, latents, masks, padded.crop, padded.domain, None
        ).to_numpy()
        results.update({index: unpadded(decoded[row]) for row, index in enumerate(indices)})
    return [results[index] for index in range(len(scenes))]
