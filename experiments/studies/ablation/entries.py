"""Entries of an ablation: the mechanisms of ``scjax.nn.cross_attention``, controls, and ways to train one of them.

Captions have 40 tokens on average and images 392, against up to 512 in the paper. The options of attention-variants §5
are scaled accordingly: windows hold a third of the keys, probed buckets a quarter. Mechanisms that approximate a
trained model in their papers (saap, squeezed) are sparse from the first step on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from scjax.nn.cross_attention import OPTIONS

MODALITIES = ("text", "image")
PADDED_SLOTS = 192
"""Slots of a caption in padded entries: about four times its tokens, as the 512 slots of the paper's prompts."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One row of the ablation.

    Attributes:
      title: name in tables.
      cross_attention: name of the mechanism.
      options: options other than the mechanism's defaults.
      text, image: further options for one modality.
      padded: whether attention reads padding and a dropped condition is zeros, as in the release.
      training: fields of the training config that differ, by path, such as ``loss.condition_dropout``.
      modalities: conditions that it is trained on.
    """

    title: str
    cross_attention: str
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    text: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    image: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    padded: bool = False
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    modalities: tuple[str, ...] = MODALITIES

    def options_of(self, modality: str) -> dict[str, Any]:
        """Options other than the defaults, for one modality."""
        return {**self.options, **(self.text if modality == "text" else self.image)}


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
    # Controls for the memory tokens and the number of parameters of cross-global (§1.4, §4.10).
    "memory": Entry("full + 32 memory tokens", "full", {"memory_tokens": 32}, modalities=("text",)),
    "matched": Entry("full, parameters of cross-global", "full", {"inner_ratio": 2}, modalities=("text",)),
    # Windows of FlashAttention-2 end with the keys, and the keys of the release end with padding (§1.3, §4.7).
    "windowed_ends": Entry("windowed, ends aligned, true lengths", "windowed", _ENDS, text=_WINDOW),
    "windowed_padded": Entry(
        "windowed, ends aligned, padded", "windowed", _ENDS, text=_WINDOW, padded=True, modalities=("text",)
    ),
    "padded": Entry("full, padded", "full", padded=True, modalities=("text",)),
}

_DROPOUT = "loss.condition_dropout"


def _recipe(title: str, **training: Any) -> Entry:
    return Entry(title, "cross_global", training=training, modalities=("text",))


# The entry above drops a tenth of its conditions and trains all weights; the paper freezes the base.
RECIPES = {
    "cross_global": MECHANISMS["cross_global"],
    "undropped": _recipe("cross-global, no condition dropped", **{_DROPOUT: 0.0}),
    "dropped_quarter": _recipe("cross-global, a quarter dropped", **{_DROPOUT: 0.25}),
    "dropped_half": _recipe("cross-global, half dropped", **{_DROPOUT: 0.5}),
    "frozen": _recipe("cross-global, base frozen", freeze=True),
}

ENTRIES = MECHANISMS | RECIPES


def select_entries(names: tuple[str, ...], modality: str) -> list[str]:
    """The entries among ``names`` that are trained on a modality, ``none`` first.

    Raises:
      ValueError: an unknown name or modality.
    """
    if modality not in MODALITIES:
        raise ValueError(f"config.modalities: {modality!r} is unknown: choose of {', '.join(MODALITIES)}")
    for name in names:
        if name not in ENTRIES:
            raise ValueError(f"config.entries: {name!r} is unknown: choose of {', '.join(ENTRIES)}")
    return [name for name in sorted(set(names), key=list(ENTRIES).index) if modality in ENTRIES[name].modalities]
