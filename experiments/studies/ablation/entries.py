"""What an ablation compares: the mechanisms of ``scjax.nn.cross_attention`` as they are trained here, controls beside them, and
ways to train one of them.

Captions have 40 tokens in the mean and images 392, against up to 512 in the paper: what the note sets for those sizes
(attention-variants §5) is scaled, so that windows hold a third, probed buckets a quarter of the keys, as there. Those
that approximate a trained model in their papers (saap, squeezed) are sparse from the first step on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from scjax.nn.cross_attention import OPTIONS

KINDS = ("text", "image")
PADDED_SLOTS = 192
"""Slots of a caption in the padded rows: about four times its tokens, as 512 are of the paper's prompts."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One row.

    Attributes:
      title: what the tables call it.
      cross_attention: name of the mechanism.
      options: those that differ from the mechanism's defaults; ``text`` and ``image``: for one kind only.
      padded: whether padded tokens are read, and a dropped condition is zeros, as in the release.
      training: fields of the training that differ, by their path, such as ``loss.condition_dropout``.
      kinds: conditions that it is trained on.
    """

    title: str
    cross_attention: str
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    text: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    image: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    padded: bool = False
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    kinds: tuple[str, ...] = KINDS

    def options_of(self, kind: str) -> dict[str, Any]:
        """The options that are not the defaults, for one kind of condition."""
        return {**self.options, **(self.text if kind == "text" else self.image)}


_WINDOW = {"window": 6}  # of the 40 tokens of a caption
_ENDS = {"alignment": "fa2", "per_modality": False}

_SPECIAL = {
    "none": Entry("no condition", "none"),
    "concat": Entry("concatenation", "concat"),
    "saap": Entry("saap", "saap", {"mode": "joint"}, text={"buckets": 8, "probes": 2}),
    "windowed": Entry("windowed", "windowed", text=_WINDOW),
    "squeezed": Entry("squeezed", "squeezed", {"rule": "top"}, text={"clusters": 8}),
}
"""Mechanisms whose title or options differ from their name and their defaults."""

_PLAIN = {name: Entry(name.replace("_", "-"), name) for name in OPTIONS}

MECHANISMS = {
    **_PLAIN,
    **_SPECIAL,
    # What cross-global owes to tokens that ignore the condition, and to its parameters (§1.4, §4.10).
    "memory": Entry("full + 32 memory tokens", "full", {"memory_tokens": 32}, kinds=("text",)),
    "matched": Entry("full, parameters of cross-global", "full", {"inner_ratio": 2}, kinds=("text",)),
    # Windows of FlashAttention-2 end where the keys end, and the release's keys end with its padding (§1.3, §4.7).
    "windowed_ends": Entry("windowed, ends aligned, true lengths", "windowed", _ENDS, text=_WINDOW),
    "windowed_padded": Entry(
        "windowed, ends aligned, padded", "windowed", _ENDS, text=_WINDOW, padded=True, kinds=("text",)
    ),
    "padded": Entry("full, padded", "full", padded=True, kinds=("text",)),
}

_DROPOUT = "loss.condition_dropout"


def _recipe(title: str, **training: Any) -> Entry:
    return Entry(title, "cross_global", training=training, kinds=("text",))


# Cross-global as it is above drops a tenth of its conditions and trains all weights; the paper keeps those of the base.
RECIPES = {
    "cross_global": MECHANISMS["cross_global"],
    "undropped": _recipe("cross-global, no condition dropped", **{_DROPOUT: 0.0}),
    "dropped_quarter": _recipe("cross-global, a quarter dropped", **{_DROPOUT: 0.25}),
    "dropped_half": _recipe("cross-global, half dropped", **{_DROPOUT: 0.5}),
    "frozen": _recipe("cross-global, base frozen", freeze=True),
}

ENTRIES = MECHANISMS | RECIPES


def chosen(names: tuple[str, ...], kind: str) -> list[str]:
    """Those of ``names`` that are trained on a kind of condition, ``none`` first.

    Raises:
      ValueError: an unknown name, or kind.
    """
    if kind not in KINDS:
        raise ValueError(f"config.kinds: {kind!r} is no kind of condition: choose of {', '.join(KINDS)}")
    for name in names:
        if name not in ENTRIES:
            raise ValueError(f"config.entries: {name!r} is unknown: choose of {', '.join(ENTRIES)}")
    return [name for name in sorted(set(names), key=list(ENTRIES).index) if kind in ENTRIES[name].kinds]
