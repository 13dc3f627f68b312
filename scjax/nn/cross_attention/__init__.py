"""Ways to condition scene tokens on context tokens, one a file, with one interface (attention-variants.md).

A mechanism is chosen by its options: a frozen, hashable dataclass, part of a network's config. ``build`` makes its
module; ``from_name`` and ``to_config`` go between options and plain text.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable
from typing import Any, ClassVar

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.agent import Agent, AgentOptions
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, CrossAttention
from scjax.nn.cross_attention.concat import Concat, ConcatOptions
from scjax.nn.cross_attention.cross_global import CrossGlobal, CrossGlobalOptions
from scjax.nn.cross_attention.deformable import Deformable, DeformableOptions
from scjax.nn.cross_attention.full import Full, FullOptions
from scjax.nn.cross_attention.gated import Gated, GatedOptions
from scjax.nn.cross_attention.linear import FocusedLinear, LinearOptions
from scjax.nn.cross_attention.saap import Saap, SaapOptions
from scjax.nn.cross_attention.squeezed import Squeezed, SqueezedOptions
from scjax.nn.cross_attention.windowed import Windowed, WindowedOptions
from scjax.nn.init import ParamInit

__all__ = [
    "OPTIONS",
    "AuxOutputs",
    "ContextSpec",
    "CrossAttention",
    "CrossAttentionOptions",
    "NoOptions",
    "build",
    "from_name",
    "to_config",
]


@dataclasses.dataclass(frozen=True)
class NoOptions:
    """No mechanism: the condition is ignored, a control for what any of them adds."""

    empty_is_zero: ClassVar[bool] = True


CrossAttentionOptions = (
    NoOptions
    | ConcatOptions
    | FullOptions
    | GatedOptions
    | LinearOptions
    | AgentOptions
    | SaapOptions
    | WindowedOptions
    | DeformableOptions
    | SqueezedOptions
    | CrossGlobalOptions
)
"""``empty_is_zero`` of the options tells whether a scene without condition tokens gets exactly zero."""

OPTIONS = {
    "none": NoOptions,
    "concat": ConcatOptions,
    "full": FullOptions,
    "gated": GatedOptions,
    "linear": LinearOptions,
    "agent": AgentOptions,
    "saap": SaapOptions,
    "windowed": WindowedOptions,
    "deformable": DeformableOptions,
    "squeezed": SqueezedOptions,
    "cross_global": CrossGlobalOptions,
}

_MODULES: dict[type, Callable[..., CrossAttention] | None] = {
    NoOptions: None,
    ConcatOptions: Concat,
    FullOptions: Full,
    GatedOptions: Gated,
    LinearOptions: FocusedLinear,
    AgentOptions: Agent,
    SaapOptions: Saap,
    WindowedOptions: Windowed,
    DeformableOptions: Deformable,
    SqueezedOptions: Squeezed,
    CrossGlobalOptions: CrossGlobal,
}


def build(
    options: CrossAttentionOptions, width: int, heads: int, spec: ContextSpec, *, init: ParamInit,
    compute: Compute = "float32",
) -> CrossAttention | None:  # fmt: skip
    """The module; None for ``NoOptions``.

    Args:
      width, heads: of the scene tokens and of the context.
      spec: how the context's tokens lie.

    Raises:
      ValueError: ``width`` is no multiple of ``heads``, or the options do not fit the layout.
    """
    if width % heads:
        raise ValueError(f"width {width} must be a multiple of heads {heads}")
    module = _MODULES[type(options)]
    return None if module is None else module(options, width, heads, spec, init=init, compute=compute)


def from_name(name: str, **fields: Any) -> CrossAttentionOptions:
    """The options of a mechanism by its name; those not given have their defaults.

    Raises:
      ValueError: an unknown name, field or value; it lists the known ones.
    """
    if name not in OPTIONS:
        near = difflib.get_close_matches(name, OPTIONS, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ValueError(f"control {name!r} is unknown: {hint}choose one of {', '.join(OPTIONS)}")
    known = [field.name for field in dataclasses.fields(OPTIONS[name])]
    unknown = sorted(fields.keys() - known)
    if unknown:
        raise ValueError(f"control {name} has no option {', '.join(unknown)}: it has {', '.join(known) or 'none'}")
    return OPTIONS[name](**fields)


def to_config(options: CrossAttentionOptions) -> dict[str, Any]:
    """Name and fields, JSON-ready: ``from_name(**to_config(options)) == options``."""
    name = next(name for name, kind in OPTIONS.items() if isinstance(options, kind))
    return {"name": name, **dataclasses.asdict(options)}
