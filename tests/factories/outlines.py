"""Outlines of a few scenes whose measurements are chosen by hand."""

from __future__ import annotations

import numpy as np

from scjax.generate.outlines import Outlines
from scjax.language.attributes.table import measure_attributes
from scjax.models.denoiser.kinds import NO_KIND
from scjax.scene import empty


def measurements(**changes):
    """Those of an empty scene, with some replaced."""
    scene = empty(1, 0)
    scene.agent_mask[:] = True
    return measure_attributes(scene) | changes


def outlines(*rows, domains=None, lanes=4, agents=8):
    """Outlines of rows (kinds of lanes, kinds of agents, changed measurements)."""

    def padded(kinds, slots):
        return np.array([[*row, *[NO_KIND] * (slots - len(row))] for row in kinds])

    return Outlines.of_scenes(
        padded([row[0] for row in rows], lanes),
        padded([row[1] for row in rows], agents),
        np.zeros(len(rows), int) if domains is None else np.array(domains),
        [measurements(**row[2]) for row in rows],
    )
