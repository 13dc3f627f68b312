"""Behavior models by name: the one place where a new model is listed."""

from __future__ import annotations

from scjax.sim.behavior import BehaviorModel
from scjax.sim.constant_velocity import ConstantVelocity
from scjax.sim.driver import ADVERSARIAL, CALM
from scjax.sim.lane_changes import LaneChanges
from scjax.sim.route_follower import RouteFollower

BEHAVIORS: dict[str, BehaviorModel] = {
    "idm": RouteFollower(),
    "lane-changes": RouteFollower(lane_changes=LaneChanges()),
    "calm": RouteFollower(CALM, LaneChanges()),
    "adversarial": RouteFollower(ADVERSARIAL, LaneChanges()),
    "constant-velocity": ConstantVelocity(),
}
"""Names that ``scjax simulate --behavior`` takes."""
