"""The denoiser to start from: python -m benchmarks.low_noise.base OUT --octaves 9 --fit-heads RECORDS

The model that ships, without its condition. Further octaves of Fourier features start at
zero, so that the network is the same function. With --fit-heads its position heads are fitted anew.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence

import jax
import numpy as np

import scjax
from scjax.data.loader import training_batches
from scjax.data.loader_config import LoaderConfig
from scjax.generate.model import Model
from scjax.models.autoencoder.model import autoencoder
from scjax.models.denoiser.model import denoiser
from scjax.nn.functional import flatten, unflatten
from scjax.scene import Scene
from scjax.scene.per_type import PerType
from scjax.train.fit_position_head import fit_position_heads

_FOURIER = ("agent_fourier", "lane_fourier")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.low_noise.base", description=__doc__)
    parser.add_argument("out", help="model folder")
    parser.add_argument("--octaves", type=int, default=6, help="6 (the default) or more")
    parser.add_argument("--fit-heads", metavar="RECORDS", help="records to fit position heads to")
    args = parser.parse_args(arguments)
    model = unconditional(with_octaves(scjax.load(), args.octaves))
    if args.fit_heads:
        model = with_heads(model, args.fit_heads)
    scjax.save(model, args.out)


def with_heads(model: Model, records: str) -> Model:
    """The model with position heads that are fitted anew to its autoencoder."""
    network, codec = autoencoder(model.autoencoder.config), model.codec

    @jax.jit
    def encode(scene: Scene) -> PerType:
        posterior = network.apply(model.autoencoder.params, codec.normalize(scene), method="encode")
        return model.latents.normalize(posterior.mean)

    loader = LoaderConfig(
        buckets=((12, 16), (16, 28), (32, 48)), batch_size=32, crops=(14.0, 1.0, 1.0), order="recursive"
    )
    batches = training_batches(records, codec, loader)
    heads = fit_position_heads(batches, encode, jax.random.key(0))
    return model.with_component("denoiser", model.denoiser.config, {**model.denoiser.params, "position_heads": heads})


def with_octaves(model: Model, octaves: int) -> Model:
    """The model whose Fourier features have so many octaves, without its count predictor."""
    old, before = flatten(model.denoiser.params), model.denoiser.config
    config = dataclasses.replace(before, fourier_octaves=octaves)
    shapes = flatten(jax.eval_shape(denoiser(config).init, jax.random.key(0)))
    params = {path: np.asarray(old[path], np.float32) for path in shapes}
    for path, shape in shapes.items():
        if path[0] in _FOURIER and path[1:] == ("out", "kernel"):
            rows = params[path].reshape(2, config.fourier_features, before.fourier_octaves, -1)
            more = ((0, 0), (0, 0), (0, octaves - before.fourier_octaves), (0, 0))
            params[path] = np.pad(rows, more).reshape(shape.shape)
    return model.with_component("denoiser", config, unflatten(params)).without("count_predictor")


def unconditional(model: Model) -> Model:
    """The model without its condition."""
    old, config = flatten(model.denoiser.params), dataclasses.replace(model.denoiser.config, condition=None)
    shapes = flatten(jax.eval_shape(denoiser(config).init, jax.random.key(0)))
    params = unflatten({path: old[path] for path in shapes})
    model = model.with_component("denoiser", config, params)
    return dataclasses.replace(model, text_encoder="", prompts={})


if __name__ == "__main__":
    main()
