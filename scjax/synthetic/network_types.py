"""Types of road networks.

To add a type, write a file with a function (style, rng) -> ``Network``, add a line to ``NETWORK_BUILDERS``, and give
the type a weight in ``scjax.synthetic.domains``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scjax.synthetic.junctions import InfeasiblePlan
from scjax.synthetic.motorway import build_motorway
from scjax.synthetic.network import Network
from scjax.synthetic.parking_lot import build_parking_lot
from scjax.synthetic.plan import RoadPlan, build_network
from scjax.synthetic.street_plans import (
    plan_blocks,
    plan_dead_end,
    plan_intersection,
    plan_road,
    plan_roundabout,
    plan_side_streets,
    plan_winding_road,
    plan_y_junction,
)
from scjax.synthetic.streets import StreetStyle

NetworkBuilder = Callable[[StreetStyle, np.random.Generator], Network]
_ATTEMPTS = 200


def _from_plan(draw_plan: Callable[[StreetStyle, np.random.Generator], RoadPlan]) -> NetworkBuilder:
    return lambda style, rng: build_network(draw_plan(style, rng), rng)


NETWORK_BUILDERS: dict[str, NetworkBuilder] = {
    "road": _from_plan(plan_road),
    "winding road": _from_plan(plan_winding_road),
    "crossing": _from_plan(plan_intersection),
    "Y": _from_plan(plan_y_junction),
    "side streets": _from_plan(plan_side_streets),
    "blocks": _from_plan(plan_blocks),
    "roundabout": _from_plan(plan_roundabout),
    "dead end": _from_plan(plan_dead_end),
    "parking lot": build_parking_lot,
    "motorway": lambda style, rng: build_motorway(rng),
}
"""Network type (as in labels) -> builder."""


def draw_network(network_type: str, style: StreetStyle, rng: np.random.Generator) -> Network:
    """A random network of one type.

    Raises:
      RuntimeError: if the junctions leave no room for the roads in 200 attempts.
    """
    for _ in range(_ATTEMPTS):
        try:
            return NETWORK_BUILDERS[network_type](style, rng)
        except InfeasiblePlan:
            continue
    raise RuntimeError(f"no network of type {network_type!r} could be built in {_ATTEMPTS} attempts: widen the style")
