"""Depth by the vision network that comes with scjax."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Array, Float32

from scjax.camera.photo import Photo
from scjax.encoders.base import PublishedNetwork, pure_functions
from scjax.encoders.dashcam_network import DashcamConfig
from scjax.encoders.image_network import LoadedNetwork, run_padded
from scjax.encoders.preprocessing import Preprocessing, prepare_image
from scjax.nn.cpu.precision import operands


class DashcamDepth:
    """Depth of photos in meters, for cameras like those of its training; coarse: 28 x 28 cells a picture."""

    def __init__(self, loaded: LoadedNetwork):
        self.config, self.params, self.name = loaded.config, loaded.params, loaded.name
        self._program = _depth_program(loaded.network, loaded.config)

    def key_of(self, photo: Photo) -> str:
        """Name and precision."""
        return f"{self.name}-depth-{operands(self.config.compute)}"

    def __call__(self, photo: Photo) -> Float32[np.ndarray, "height width"]:
        """Depth of the cells.

        Raises:
          ValueError: depth that is not finite, as of damaged weights.
        """
        squashed = Preprocessing("squash", self.config.rows, self.config.columns)
        pixels = prepare_image(photo, squashed, self.config.patch_size).pixels
        depth = run_padded(self._program, self.params, [pixels])[0]
        if not np.isfinite(depth).all():
            raise ValueError(f"the depth network {self.name} has results that are not finite: copy its folder again")
        return depth


@functools.lru_cache(maxsize=2)
def _depth_program(network: PublishedNetwork, config: DashcamConfig) -> Callable[..., Array]:
    """(parameters, pixels) -> depth, compiled once however often the folder is loaded."""
    return jax.jit(functools.partial(pure_functions(network, config).apply, method="depth"))
