"""What a user asks of a scene."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Array

from scjax.scene import Crop, Scene


@dataclasses.dataclass(frozen=True, kw_only=True)
class Condition:
    """What ``scjax.sample`` holds fixed; everything left out is drawn.

    Attributes:
      num_lanes, num_agents: totals, ego and known elements included; by default drawn from the data's joint table.
      domain: a name or index from the model's list; by default drawn from the data's frequencies.
      crop: which window: centred on the ego (the default), or ahead of it.
      prompt: what the scene shall show, for a model trained on text; its tokens come from the model's text encoder.
      negative_prompt: what it shall not show: guidance leads away from it instead of from no prompt at all.
      tokens: condition tokens [n, features] instead of a prompt.
      token_mask: [n] True for real tokens; by default all.
      negative_tokens: tokens instead of a negative prompt, all of them real.
      image: features [channels, rows, columns] of what lies ahead, for a model trained on images; it needs ``depth``
        and the forward layout. ``scjax.camera.raycast`` makes both of a scene.
      depth: [height, width] of the same picture, in 0..1.
      known: one scene whose lanes and agents are kept exactly; new ones are added up to the totals. With all lanes
        known and ``num_lanes`` equal to their number this is lane-conditioned traffic generation.
    """

    num_lanes: int | None = None
    num_agents: int | None = None
    domain: str | int | None = None
    crop: Crop = Crop.CENTERED
    prompt: str | None = None
    negative_prompt: str | None = None
    tokens: Array | np.ndarray | None = None
    token_mask: Array | np.ndarray | None = None
    negative_tokens: Array | np.ndarray | None = None
    image: Array | np.ndarray | None = None
    depth: Array | np.ndarray | None = None
    known: Scene | None = None

    def __post_init__(self):
        for name in ("num_lanes", "num_agents"):
            value = getattr(self, name)
            if value is not None and (value != int(value) or value < 1):
                raise ValueError(f"Condition.{name} must be a whole number of at least 1, not {value!r}")
        if self.crop not in tuple(Crop):
            raise ValueError(f"Condition.layout must be one of {[kind.name for kind in Crop]}, not {self.crop!r}")
        if self.known is not None and self.known.batch_shape:
            raise ValueError(
                f"Condition.known must be a single scene, not a batch of shape {self.known.batch_shape}: take one "
                "with known[i]"
            )
        for name, text in (("tokens", self.prompt), ("negative_tokens", self.negative_prompt)):
            tokens = getattr(self, name)
            if tokens is not None and np.ndim(tokens) != 2:
                raise ValueError(f"Condition.{name} must be [tokens, features], not of rank {np.ndim(tokens)}")
            if tokens is not None and text is not None:
                raise ValueError(f"Condition.{name} and a prompt are both given: leave one of them out")
        for name, axes in (("image", "channels, rows, columns"), ("depth", "height, width")):
            features = getattr(self, name)
            if features is not None and np.ndim(features) != axes.count(",") + 1:
                raise ValueError(f"Condition.{name} must be [{axes}], not of shape {np.shape(features)}")
        if (self.image is None) != (self.depth is None):
            raise ValueError("Condition.image and Condition.depth belong together: give both or neither")
        if self.image is not None and self.crop != Crop.FORWARD:
            raise ValueError(
                f"Condition.image shows what lies ahead of the ego, but the layout is {Crop(self.crop).name}: "
                "give layout=Layout.FORWARD"
            )
        if self.image is not None and (self.prompt is not None or self.tokens is not None):
            raise ValueError("Condition.image and a prompt are both given: a model reads one of them, leave one out")
