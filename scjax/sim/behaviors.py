"""Behavior models by name: the one place where a new model is listed."""

from __future__ import annotations

from collections.abc import Callable

from scjax.sim.behavior import BehaviorModel
from scjax.sim.behavior_weights import load_behavior
from scjax.sim.constant_velocity import ConstantVelocity
from scjax.sim.driver import ADVERSARIAL, CALM
from scjax.sim.lane_changes import LaneChanges
from scjax.sim.learned import LearnedBehavior
from scjax.sim.route_follower import RouteFollower

BEHAVIORS: dict[str, Callable[[], BehaviorModel]] = {
    "idm": RouteFollower,
    "lane-changes": lambda: RouteFollower(lane_changes=LaneChanges()),
    "calm": lambda: RouteFollower(CALM, LaneChanges()),
    "adversarial": lambda: RouteFollower(ADVERSARIAL, LaneChanges()),
    "learned": lambda: LearnedBehavior(load_behavior()),
    "constant-velocity": ConstantVelocity,
}
"""Name -> function that makes the model."""


def as_behavior(value: BehaviorModel | str | None) -> BehaviorModel:
    """A model, by its name if it is a text; ``RouteFollower()`` for None.

    Raises:
      ValueError: no model has this name.
    """
    if value is None:
        return RouteFollower()
    if isinstance(value, str):
        if value not in BEHAVIORS:
            raise ValueError(f"behavior is {value!r}: choose one of {', '.join(BEHAVIORS)}, or give a model")
        return BEHAVIORS[value]()
    return value
