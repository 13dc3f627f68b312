"""Moments of synthetic worlds from which a policy starts to drive."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import Log
from scjax.sim.preparation import prepare
from scjax.synthetic.recording import object_index, to_log
from scjax.synthetic.world import make_world

_MIN_SPEED = 2.0  # m/s of the vehicle that is driven
_SHAPE = (32, 4096, 256, 512)  # of all sources, so that a step is small


def driving_sources(seed: int, first: int, count: int) -> list[Log]:
    """The first ``count`` moments of the worlds ``first``, ``first`` + 1, ... of ``seed``, at most one of a world.

    Worlds with more than 32 agents, or whose egos all stand or follow no lane, are left out.
    """
    sources: list[Log] = []
    k = first
    while len(sources) < count:
        source = _moving_ego(seed, k)
        k += 1
        if source is not None:
            sources.append(source)
    return sources


def _moving_ego(seed: int, k: int) -> Log | None:
    """A moment of world ``k`` whose ego moves along a lane."""
    world = make_world(seed, k, event_share=0.0)
    log = to_log(world)
    for ego in world.egos:
        row = object_index(world, ego.moment, ego.agent)
        moment = dataclasses.replace(log.select_steps([ego.moment]), ego_index=row)
        start = prepare(moment, 0, np.random.default_rng(0))
        if start.shape == _SHAPE and start.places.lane[0] >= 0 and start.agents.speed[0] > _MIN_SPEED:
            return moment
    return None
