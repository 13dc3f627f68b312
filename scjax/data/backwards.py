"""A scene seen in a mirror with time running backwards: another road on which traffic keeps to the same side.

A mirror alone turns right-hand traffic into left-hand traffic; turning every lane and agent round as well turns it
back. What lies ahead of the ego then lies behind it, and forks are merges. Where recordings are few this doubles the
roads that a network sees. It is no scene that was (queues stand behind the junction), and so of a domain of its own,
which a model is asked for by name alone.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.data import ragged
from scjax.data.crop import Context


def backwards(context: Context) -> Context:
    """``context`` with x mirrored and lanes, links and headings turned round; doing it twice gives it back.

    A lane on the left stays on the left, speeds and signals stay as they are.
    """
    starts, ends = context.offsets[:-1], context.offsets[1:]
    turned = np.repeat(starts + ends - 1, ends - starts) - np.arange(len(context.points))  # last point first, each lane
    length = ragged.arc_lengths(context.points, context.offsets)[ends - 1]
    spans = np.empty_like(context.spans)
    for side in (0, 1):
        own, whole = slice(2 * side, 2 * side + 2), length[context.beside[:, side]]
        spans[:, own] = whole[:, None] - context.spans[:, own][:, ::-1]
    return dataclasses.replace(
        context,
        points=context.points[turned] * np.array([-1, 1, 1], np.float32),
        edges=context.edges[:, ::-1],
        spans=spans,
        agents=context.agents * np.array([-1, 1, 1, 1, 1, -1, 1, 1, 1], np.float32),  # x and the sine of the heading
    )


def backwards_of(domain: str) -> str:
    """The domain of scenes of ``domain`` that are turned round."""
    return f"{domain} backwards"
