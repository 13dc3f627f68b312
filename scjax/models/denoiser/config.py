"""Sizes and options of the denoiser; the preset "official" is the released architecture (official-spec §0, §4)."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, get_args

from scjax.nn.cpu.precision import Compute, check_compute
from scjax.nn.cross_attention import (
    ContextSpec,
    CrossAttentionOptions,
    CrossGlobalOptions,
    GatedOptions,
    from_name,
    to_config,
)

Prediction = Literal["noise", "velocity", "flow"]
"""The network's target: the noise (official); the velocity sqrt(abar_t) noise - sqrt(1 - abar_t) x_0 (Salimans & Ho
2022); or noise - x_0 on the straight path of a rectified flow (Liu et al. 2023)."""

_MAY_BE_ZERO = ("fourier_features",)
_MOST_DIGITS = 1000  # values of a digit of a kind
MAX_OCTAVES = 20
"""Largest ``DenoiserConfig.fourier_octaves``."""

Schedule = Literal["cosine", "log_snr"]
"""The noise levels of training and sampling: the cosine schedule (official), or one that goes on to a deviation of
0.005 (``diffusion.log_snr_schedule``)."""


@dataclasses.dataclass(frozen=True)
class TextCondition:
    """Text token features of ``width`` numbers each (official-spec §4.7: UMT5-XXL, 4096)."""

    width: int = 4096

    def __post_init__(self):
        _positive(self, "width")


@dataclasses.dataclass(frozen=True)
class ImageCondition:
    """DINO features [channels, *grid] and a depth map, averaged over ``patch`` x ``patch`` cells (spec §4.8).

    ``depth`` False: the network reads no depth, as where the features say it. Not in the release.
    """

    channels: int = 384
    grid: tuple[int, int] = (14, 14)
    patch: int = 16
    depth: bool = True

    def __post_init__(self):
        _positive(self, "channels", "patch")
        if len(self.grid) != 2 or min(self.grid) < 1:
            raise ValueError(f"ImageCondition.grid must be (rows, columns), both positive, got {self.grid}")


ConditionConfig = TextCondition | ImageCondition | None
_RELEASED = CrossGlobalOptions()


_CHANGES = {"known_embedding": True, "prediction": "velocity"}
PRESETS: dict[str, dict[str, Any]] = {
    # The released network, including its conventions for padding and initialization.
    "official": {"attend_padding": True, "cross_adaln_init": "xavier"},
    # One GPU: heads of 64.
    "base": {"lane_width": 512, "lane_heads": 8, "agent_width": 256, "agent_heads": 4, **_CHANGES},
    # A few CPU cores.
    "small": {"lane_width": 256, "lane_heads": 8, "agent_width": 128, "agent_heads": 4, **_CHANGES},
    # Minutes on a laptop, for a first look.
    "tiny": {"lane_width": 128, "lane_heads": 4, "agent_width": 64, "agent_heads": 2, **_CHANGES},
}
"""Sizes and options of ``DenoiserConfig.preset``; all but "official" differ from the release in ``_CHANGES``."""


@dataclasses.dataclass(frozen=True)
class DenoiserConfig:
    """Architecture of the denoiser.

    Attributes:
      lane_width, lane_heads: width and heads of the agents-to-lanes and lanes-to-lanes stages.
      agent_width, agent_heads: the same of the lanes-to-agents and agents-to-agents stages.
      mlp_ratio: hidden width of a stage's MLP over its width.
      blocks, l2l_stages: factorized blocks, and lanes-to-lanes stages in each.
      lane_latent, agent_latent: latent numbers per token.
      max_lanes, max_agents: largest numbers of tokens (sizes of the count tables and position tables).
      domains, crops: the label table has one row per pair (``domains * crop + domain``), and the null row last.
      condition: the condition besides label and counts; None for the unconditional network.
      cross_attention: how scene tokens read the condition: options of a mechanism (``scjax.nn.cross_attention``).
      attributes: names of the features of a request that are added to the label's embedding; () for none. Not in the
        release.
      agent_kinds, lane_kinds: sizes of the digits of kinds (``denoiser.kinds``), of which the network may be given
        each token's; (): it is given none. Not in the release.
      known_embedding: add a learned vector per type (zero at first) to known tokens. Not in the release.
      fourier_features: number of learned projections of a token's latents whose sines and cosines are added to its
        embedding; 0 for none (official).
      fourier_octaves: wavelengths of the Fourier features, each half of the one before; the first is 8 deviations.
      relative_geometry: add features of nearby tokens to the embeddings (``denoiser.relative_geometry``). Not in the
        release.
      prediction: what the network predicts, "noise" (official), "velocity" or "flow".
      schedule: noise levels of training and sampling, "cosine" (official) or "log_snr".
      cross_adaln_init: "zero" (a fresh conditional network equals its unconditional part) or "xavier" (official).
      attend_padding: the official convention, in which padded text tokens are valid keys and a dropped condition is a
        context of zeros. Otherwise padded and dropped tokens are masked, and a dropped condition adds exactly zero.
      compute: precision of the operands of products with the weights.
    """

    lane_width: int = 2048
    lane_heads: int = 16
    agent_width: int = 512
    agent_heads: int = 8
    mlp_ratio: int = 4
    blocks: int = 2
    l2l_stages: int = 1
    lane_latent: int = 24
    agent_latent: int = 10
    max_lanes: int = 100
    max_agents: int = 61
    domains: int = 4
    crops: int = 3
    condition: ConditionConfig = None
    cross_attention: CrossAttentionOptions = _RELEASED
    attributes: tuple[str, ...] = ()
    agent_kinds: tuple[int, ...] = ()
    lane_kinds: tuple[int, ...] = ()
    known_embedding: bool = False
    fourier_features: int = 0
    fourier_octaves: int = 6
    relative_geometry: bool = False
    prediction: Prediction = "noise"
    schedule: Schedule = "cosine"
    cross_adaln_init: Literal["zero", "xavier"] = "zero"
    attend_padding: bool = False
    compute: Compute = "float32"

    def __post_init__(self):
        integers = [field.name for field in dataclasses.fields(self) if field.type == "int"]
        _positive(self, *(name for name in integers if name not in _MAY_BE_ZERO or getattr(self, name) != 0))
        if self.fourier_octaves > MAX_OCTAVES:
            raise ValueError(
                f"fourier_octaves must be at most {MAX_OCTAVES}, where the wavelength is that of float32 rounding, "
                f"got {self.fourier_octaves}"
            )
        for kind in ("lane", "agent"):
            width, heads = getattr(self, f"{kind}_width"), getattr(self, f"{kind}_heads")
            if width % heads:
                raise ValueError(f"{kind}_width {width} must be a multiple of {kind}_heads {heads}")
            if width % 2:
                raise ValueError(f"{kind}_width {width} must be even: half of a position code is sine, half cosine")
        if isinstance(self.condition, ImageCondition) and self.lane_width % 4:
            raise ValueError(f"lane_width {self.lane_width} must be a multiple of 4 for the position code of an image")
        if self.cross_adaln_init not in ("zero", "xavier"):
            raise ValueError(f'cross_adaln_init must be "zero" or "xavier", got {self.cross_adaln_init!r}')
        if not isinstance(self.cross_attention, CrossAttentionOptions):
            raise ValueError(
                "cross_attention must be the options of a mechanism, such as CrossGlobalOptions(), not "
                f"{self.cross_attention!r}: scjax.nn.cross_attention.from_name finds them by name"
            )
        if (
            isinstance(self.cross_attention, GatedOptions)
            and not self.cross_attention.start
            and self.cross_adaln_init == "zero"
        ):
            raise ValueError(
                'GatedOptions.start is 0 and cross_adaln_init "zero": a product of two zeros never trains. Set '
                'start=1, or cross_adaln_init="xavier"'
            )
        if self.prediction not in get_args(Prediction):
            raise ValueError(f"prediction must be one of {', '.join(get_args(Prediction))}, got {self.prediction!r}")
        if self.schedule not in get_args(Schedule):
            raise ValueError(f"schedule must be one of {', '.join(get_args(Schedule))}, got {self.schedule!r}")
        if self.schedule == "log_snr" and self.prediction != "velocity":
            raise ValueError(
                f'schedule "log_snr" needs a network that estimates the velocity, not the {self.prediction}: set '
                'prediction="velocity", or schedule="cosine"'
            )
        for name in ("agent_kinds", "lane_kinds"):
            sizes = getattr(self, name)
            if not isinstance(sizes, tuple) or not all(type(one) is int and 1 <= one <= _MOST_DIGITS for one in sizes):
                raise ValueError(f"DenoiserConfig.{name} is {sizes!r:.80}: give whole numbers from 1 to {_MOST_DIGITS}")
        if bool(self.agent_kinds) != bool(self.lane_kinds):
            raise ValueError("DenoiserConfig.agent_kinds and lane_kinds belong together: give both or neither")
        if len(set(self.attributes)) < len(self.attributes):
            raise ValueError("DenoiserConfig.attributes names a feature twice: name each once")
        check_compute(self.compute)

    def to_json(self) -> dict[str, Any]:
        """The fields as plain values; those of ``cross_attention`` with the mechanism's name."""
        return {**dataclasses.asdict(self), "cross_attention": to_config(self.cross_attention)}

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> DenoiserConfig:
        """Inverse of ``to_json``."""
        condition = fields["condition"]
        if condition is not None:
            condition_type: Any = ImageCondition if "channels" in condition else TextCondition
            condition = condition_type(
                **{name: tuple(value) if isinstance(value, list) else value for name, value in condition.items()}
            )
        tuples = {name: tuple(value) for name, value in fields.items() if isinstance(value, list)}
        return cls(
            **{**fields, **tuples, "condition": condition, "cross_attention": from_name(**fields["cross_attention"])}
        )

    @classmethod
    def preset(cls, name: str, **changes: Any) -> DenoiserConfig:
        """The sizes of ``PRESETS[name]``, with some fields changed.

        Raises:
          ValueError: an unknown name; it lists the known ones.
        """
        if name not in PRESETS:
            raise ValueError(f"there is no denoiser preset {name!r}: choose one of {', '.join(PRESETS)}")
        return cls(**{**PRESETS[name], **changes})

    @property
    def is_conditional(self) -> bool:
        """Whether the network reads anything besides label, counts and known tokens."""
        return self.condition is not None or bool(self.attributes)

    @property
    def null_label(self) -> int:
        """Row of the label table for an unknown label: the last one."""
        return self.domains * self.crops

    @property
    def context_spec(self) -> ContextSpec:
        """Layout of the context tokens: along a text, or on the grid of the image and then of the depth map."""
        if isinstance(self.condition, ImageCondition):
            return ContextSpec(kind="image", grid=self.condition.grid, modalities=1 + self.condition.depth)
        return ContextSpec(kind="text")

    @property
    def position_table_size(self) -> int:
        """Scalars in the fixed position tables, which the official parameter counts include."""
        size = self.max_lanes * self.lane_width + self.max_agents * self.agent_width
        if isinstance(self.condition, ImageCondition):
            size += self.condition.grid[0] * self.condition.grid[1] * self.lane_width
        return size


def _positive(config, *names: str) -> None:
    for name in names:
        value = getattr(config, name)
        if not isinstance(value, int) or value < 1:
            raise ValueError(f"{type(config).__name__}.{name} must be a positive integer, got {value!r}")
