"""Sizes of the autoencoder and its presets (official-spec §0, §2)."""

from __future__ import annotations

import dataclasses
from typing import Any

from scjax.nn.cpu.precision import Compute, check_compute

# State that a source may not have recorded: z, length, width, height of an agent; z of a lane.
_UNCERTAIN_AGENT_COLUMNS = (2, 6, 7, 8)
_UNCERTAIN_LANE_DIMS = (2,)


_CLASSES = {"lane_types": 4, "agent_types": 4, "link_types": 6}
PRESETS: dict[str, dict[str, Any]] = {
    # The published network: 32,434,148 parameters with its never-used ones (see ``scjax.convert.autoencoder``).
    "official": {
        "lane_width": 512,
        "lane_heads": 4,
        "lane_ff": 2048,
        "agent_width": 256,
        "agent_heads": 4,
        "agent_ff": 1024,
        "edge_width": 64,
        "point_dims": 2,
        "lane_types": 3,
        "agent_types": 3,
        "link_types": 4,
    },
    # Half the official widths, with z, signals, sides and known flags: the default for a GPU.
    "base": {
        "lane_width": 256,
        "lane_heads": 4,
        "lane_ff": 1024,
        "agent_width": 128,
        "agent_heads": 4,
        "agent_ff": 512,
        "edge_width": 64,
        "point_dims": 3,
        "known_inputs": True,
        **_CLASSES,
    },
    # Trains on a CPU.
    "small": {
        "lane_width": 128,
        "lane_heads": 4,
        "lane_ff": 512,
        "agent_width": 64,
        "agent_heads": 4,
        "agent_ff": 256,
        "edge_width": 64,
        "point_dims": 3,
        "known_inputs": True,
        **_CLASSES,
    },
    # Minutes on a laptop, for a first look.
    "tiny": {
        "lane_width": 96,
        "lane_heads": 4,
        "lane_ff": 192,
        "agent_width": 64,
        "agent_heads": 4,
        "agent_ff": 128,
        "edge_width": 16,
        "point_dims": 3,
        "known_inputs": True,
        "encoder_blocks": 1,
        "decoder_blocks": 1,
        **_CLASSES,
    },
}
"""Sizes of ``AutoencoderConfig.preset``."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class AutoencoderConfig:
    """Sizes of the network, its inputs and its outputs.

    Attributes:
      lane_width, lane_heads, lane_ff: width, attention heads and feed-forward width of the lane layers.
      agent_width, agent_heads, agent_ff: the same of the agent layers.
      edge_width: features per lane pair.
      lane_types, agent_types, link_types: numbers of classes of the ``SceneCodec``; lane_types may be 0.
      encoder_blocks, decoder_blocks: factorized blocks of each half.
      lane_latent, agent_latent: latent numbers per token.
      points, point_dims: points per lane and coordinates per point (2: x, y; 3: x, y, z).
      columns: state columns per agent.
      max_lanes: the lane-count head has the classes 0..max_lanes.
      known_inputs: append flags to the inputs that separate recorded from filled-in values (z; z, length, width,
        height).
      shared_endpoints: whether decoded lane ends that links join become one point (``models.shared_endpoints``). Not in
        the release.
      compute: precision of the operands of matrix products; everything else is float32.
    """

    lane_width: int
    lane_heads: int
    lane_ff: int
    agent_width: int
    agent_heads: int
    agent_ff: int
    edge_width: int
    lane_types: int
    agent_types: int
    link_types: int
    point_dims: int
    encoder_blocks: int = 2
    decoder_blocks: int = 2
    lane_latent: int = 24
    agent_latent: int = 10
    points: int = 20
    columns: int = 9
    max_lanes: int = 100
    known_inputs: bool = False
    shared_endpoints: bool = False
    compute: Compute = "float32"

    def __post_init__(self):
        for field in dataclasses.fields(self):
            least = 0 if field.name == "lane_types" else 1
            value = getattr(self, field.name)
            if field.type == "int" and (not isinstance(value, int) or value < least):
                raise ValueError(f"{field.name} must be an integer of at least {least}, not {value!r}")
        for kind in ("lane", "agent"):
            width, heads = getattr(self, f"{kind}_width"), getattr(self, f"{kind}_heads")
            if width % heads:
                raise ValueError(f"{kind}_width {width} is not divisible by {kind}_heads {heads}: change one of them")
        if self.point_dims not in (2, 3):
            raise ValueError(f"point_dims must be 2 (x, y) or 3 (x, y, z), not {self.point_dims}")
        if self.known_inputs and self.columns != 9:
            raise ValueError(
                f"known_inputs needs the 9 agent columns of scjax.scene, not {self.columns}: switch it off"
            )
        check_compute(self.compute)

    @classmethod
    def preset(cls, name: str, **changes: Any) -> AutoencoderConfig:
        """The sizes of ``PRESETS[name]``, with some fields changed.

        Raises:
          ValueError: an unknown name; it lists the known ones.
        """
        if name not in PRESETS:
            raise ValueError(f"there is no autoencoder preset {name!r}: choose one of {', '.join(PRESETS)}")
        return cls(**{**PRESETS[name], **changes})

    @property
    def agent_flags(self) -> tuple[int, ...]:
        """Agent columns whose known flag is an input."""
        return _UNCERTAIN_AGENT_COLUMNS if self.known_inputs else ()

    @property
    def lane_flags(self) -> tuple[int, ...]:
        """Lane coordinates whose known flag is an input."""
        return tuple(d for d in _UNCERTAIN_LANE_DIMS if d < self.point_dims) if self.known_inputs else ()

    @property
    def agent_inputs(self) -> int:
        """Width of an agent's input vector: state, one-hot type, known flags."""
        return self.columns + self.agent_types + len(self.agent_flags)

    @property
    def lane_inputs(self) -> int:
        """Width of a lane's input vector: points, one-hot type, known flags."""
        return self.points * self.point_dims + self.lane_types + len(self.lane_flags)
