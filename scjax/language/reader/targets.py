"""Requests as targets of the reader's network, and its outputs as requests.

Attributes with named values (choices, flags, sets) have one number for each name. Choices and flags have "unspecified"
as their first one, and exactly one name holds; of a set, every name holds or not. A range has a lower end, where 0 is
no lower end, and an upper end, where 0 is none and k stands for the number k - 1. Numbers beyond the table count as its
last.
"""

from __future__ import annotations

import functools
import types
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from scjax.language.attributes.base import Attribute, Bounds
from scjax.language.attributes.table import ATTRIBUTES, check_attributes
from scjax.language.reader.bounds import pair_scores

LEVELS = 65
"""Numbers of an end of a range: 0 to 64 vehicles or meters, 63 at the upper end."""

_TINY = 1e-30
_UNSURE = 3.0
"""The logit of "unspecified" is at most so much higher than that of an attribute that a text may ask for."""

NAMED: tuple[Attribute, ...] = tuple(one for one in ATTRIBUTES.values() if one.kind != "range")
RANGES: tuple[Attribute, ...] = tuple(one for one in ATTRIBUTES.values() if one.kind == "range")


class Targets(NamedTuple):
    """A request.

    Attributes:
      named: 1 at the names that hold, 0 elsewhere.
      ends: class of the lower and of the upper end.
    """

    named: Float[np.ndarray, "named values"]
    ends: Int[np.ndarray, "ranges 2"]


@functools.cache
def value_names(attribute: Attribute) -> tuple[Any, ...]:
    """What each number of an attribute stands for; None is "unspecified"."""
    if attribute.kind == "set":
        return attribute.values
    return (None, True, False) if attribute.kind == "flag" else (None, *attribute.values)


VALUES = max(len(value_names(attribute)) for attribute in NAMED)
"""Names that an attribute has at most."""


def is_set() -> np.ndarray:
    """Of ``NAMED``, which are sets."""
    return np.array([attribute.kind == "set" for attribute in NAMED])


def value_mask() -> np.ndarray:
    """[named, values] True where an attribute has a name."""
    return np.arange(VALUES)[None] < np.array([len(value_names(attribute)) for attribute in NAMED])[:, None]


def request_targets(request: Mapping[str, Any]) -> Targets:
    """The targets of a request.

    Raises:
      ValueError: as ``check_attributes``.
    """
    normal = check_attributes(request)
    named, ends = np.zeros((len(NAMED), VALUES), np.float32), np.zeros((len(RANGES), 2), np.int32)
    for row, attribute in enumerate(NAMED):
        value = normal.get(attribute.name)
        chosen = (value or ()) if attribute.kind == "set" else (value,)
        for name in chosen:
            named[row, value_names(attribute).index(name)] = 1
    for row, attribute in enumerate(RANGES):
        least, most = normal.get(attribute.name, (0, None))
        ends[row] = min(round(least), LEVELS - 1), 0 if most is None else 1 + min(round(most), LEVELS - 2)
    return Targets(named, ends)


class Reading(NamedTuple):
    """What a text asks for.

    Attributes:
      request: in its normal form.
      shares: attribute -> how sure the reader is, from 0 to 1.
      likely: further attributes that it may ask for, less likely than not.
    """

    request: dict[str, Any]
    shares: dict[str, float]
    likely: Mapping[str, Any] = types.MappingProxyType({})


def read_outputs(
    named: Float[np.ndarray, "named values"],
    ends: Float[np.ndarray, "ranges 2 levels"],
    numbers: Sequence[int] = (),
    compared: Sequence[Bounds] = (),
) -> Reading:
    """What the logits of one text say that names ``numbers``, with the ranges of comparisons.

    The request is the most likely one. ``likely`` is what joins it if "unspecified" counts less.
    """
    request, shares = _most_likely(named, ends, numbers, compared)
    less = np.where(is_set(), 0.0, _UNSURE)[:, None]  # a set has no "unspecified"
    named = np.concatenate([named[:, :1] - less, named[:, 1:]], 1)
    ends = np.concatenate([ends[..., :1] - _UNSURE, ends[..., 1:]], -1)
    more, _ = _most_likely(named, ends, numbers, compared)
    return Reading(request, shares, {name: value for name, value in more.items() if name not in request})


def _most_likely(
    named: Float[np.ndarray, "named values"],
    ends: Float[np.ndarray, "ranges 2 levels"],
    numbers: Sequence[int],
    compared: Sequence[Bounds],
) -> tuple[dict[str, Any], dict[str, float]]:
    """The most likely request, and how sure each of its attributes is."""
    request: dict[str, Any] = {}
    shares: dict[str, float] = {}
    for attribute, logits in zip(NAMED, named, strict=True):
        names = value_names(attribute)
        if attribute.kind == "set":
            sure = 1 / (1 + np.exp(-np.clip(logits[: len(names)], -50, 50)))
            chosen = [name for name, share in zip(names, sure, strict=True) if share > 0.5]
            if chosen:
                request[attribute.name], shares[attribute.name] = tuple(chosen), float(sure[sure > 0.5].min())
            continue
        sure = _softmax(logits[: len(names)])
        if best := int(sure.argmax()):
            request[attribute.name], shares[attribute.name] = names[best], float(sure[best])
    units = {attribute.unit for attribute in RANGES}
    plain, scores = ({unit: pair_scores(numbers, unit, LEVELS, some) for unit in units} for some in ((), compared))
    for attribute, logits in zip(RANGES, ends, strict=True):
        low, high = (_softmax(row) for row in logits)
        joint = np.log(low + _TINY)[:, None] + np.log(high + _TINY)[None]
        if not (joint + plain[attribute.unit]).argmax():  # comparisons change ranges, they add none
            continue
        stated = np.unravel_index((joint + scores[attribute.unit]).argmax(), joint.shape)
        least, most = int(stated[0]), int(stated[1]) - 1
        if least == 0 and most < 0:
            continue
        smallest, largest = attribute.limits
        least = min(max(least, smallest), largest)
        request[attribute.name] = (least, None if most < 0 else min(max(most, least), largest))
        shares[attribute.name] = float(low[stated[0]] * high[stated[1]])
    if request.get("one_way") and "lanes_total" in request and "lanes_same" not in request:
        for part in (request, shares):  # all lanes of a one-way road run with the ego
            part["lanes_same"] = part.pop("lanes_total")
    return {name: request[name] for name in ATTRIBUTES if name in request}, shares


def _softmax(logits: np.ndarray) -> np.ndarray:
    weights = np.exp(logits - logits.max())
    return weights / weights.sum()
