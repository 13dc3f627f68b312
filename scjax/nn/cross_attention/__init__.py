"""Mechanisms that condition scene tokens on context tokens, one per file, behind one interface (attention-variants.md).

A config chooses a mechanism by its options (``CrossAttentionOptions``). ``from_name`` and ``to_config`` convert options
from and to plain values. A new mechanism is one file with its options, and one line in ``_MECHANISMS``.
"""

from __future__ import annotations

import dataclasses
import difflib
from typing import Any, ClassVar

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention import (
    agent,
    concat,
    cross_global,
    deformable,
    full,
    gated,
    linear,
    saap,
    squeezed,
    windowed,
)
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, CrossAttention, CrossAttentionOptions, Work
from scjax.nn.cross_attention.cross_global import CrossGlobalOptions
from scjax.nn.cross_attention.gated import GatedOptions
from scjax.nn.init import ParamInit

__all__ = [
    "OPTIONS",
    "AuxOutputs",
    "ContextSpec",
    "CrossAttention",
    "CrossAttentionOptions",
    "CrossGlobalOptions",
    "GatedOptions",
    "NoOptions",
    "Work",
    "build_cross_attention",
    "from_name",
    "to_config",
]


@dataclasses.dataclass(frozen=True)
class NoOptions(CrossAttentionOptions):
    """No mechanism: the condition is ignored. A control for what any mechanism adds."""

    name: ClassVar[str] = "none"

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> None:
        """No module."""

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """None."""
        return Work(0, 0)


_MECHANISMS: tuple[type[CrossAttentionOptions], ...] = (
    NoOptions,
    concat.ConcatOptions,
    full.FullOptions,
    gated.GatedOptions,
    linear.LinearOptions,
    agent.AgentOptions,
    saap.SaapOptions,
    windowed.WindowedOptions,
    deformable.DeformableOptions,
    squeezed.SqueezedOptions,
    cross_global.CrossGlobalOptions,
)
OPTIONS = {options.name: options for options in _MECHANISMS}


def build_cross_attention(
    options: CrossAttentionOptions,
    width: int,
    heads: int,
    spec: ContextSpec,
    *,
    init: ParamInit,
    compute: Compute = "float32",
) -> CrossAttention | None:
    """The module of a mechanism; None for ``NoOptions``. Arguments as for ``CrossAttentionOptions.build``.

    Raises:
      ValueError: ``width`` is no multiple of ``heads``, or the options do not fit the layout.
    """
    if width % heads:
        raise ValueError(f"width {width} must be a multiple of heads {heads}")
    return options.build(width, heads, spec, init=init, compute=compute)


def from_name(name: str, **fields: Any) -> CrossAttentionOptions:
    """The options of a mechanism by its name; fields default to the mechanism's own.

    Raises:
      ValueError: an unknown name, field or value; it lists the known ones.
    """
    if name not in OPTIONS:
        matches = difflib.get_close_matches(name, OPTIONS, 1)
        suggestion = f"did you mean {matches[0]!r}? " if matches else ""
        raise ValueError(f"cross_attention {name!r} is unknown: {suggestion}choose one of {', '.join(OPTIONS)}")
    known = [field.name for field in dataclasses.fields(OPTIONS[name])]
    unknown = sorted(fields.keys() - known)
    if unknown:
        raise ValueError(
            f"cross_attention {name} has no option {', '.join(unknown)}: it has {', '.join(known) or 'none'}"
        )
    return OPTIONS[name](**fields)


def to_config(options: CrossAttentionOptions) -> dict[str, Any]:
    """Name and fields, JSON-ready: ``from_name(**to_config(options)) == options``."""
    return {"name": options.name, **dataclasses.asdict(options)}
