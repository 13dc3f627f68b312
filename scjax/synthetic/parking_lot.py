"""A parking lot next to a street: aisles between two access lanes, with rows of parking bays."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import straight_line
from scjax.synthetic.network import MPS_PER_MPH, Network, ParkingRow
from scjax.synthetic.plan import PlanEdge, PlanNode, RoadPlan, build_network
from scjax.synthetic.roads import Carriageway, RoadProfile
from scjax.synthetic.streets import MAP_RADIUS, SIDE_STREET_RANK, StreetStyle

_BAY_LENGTH = 5.2  # m
_CORNER, _OUTER_CORNER = 3.0, 4.2  # m, radii of the curbs
_ROW_MARGIN = 12.0  # m of an aisle without bays
_AISLE = RoadProfile(2.7, 2.8)
_LANE = Carriageway(1)


def build_parking_lot(style: StreetStyle, rng: np.random.Generator) -> Network:
    """Two to four aisles; one of the two access lanes leads to a street.

    Raises:
      InfeasiblePlan: if the junctions leave no room for a road between them.
    """
    aisles, depth = int(rng.integers(2, 5)), rng.uniform(34, 40)
    pitch = 2 * (_AISLE.width + _BAY_LENGTH) + rng.uniform(3.0, 5.4)
    xs = (np.arange(aisles) - (aisles - 1) / 2) * pitch
    plan = RoadPlan(
        [
            PlanNode(np.array([x, y]), corner=_OUTER_CORNER if k in (0, aisles - 1) else _CORNER, is_driveway=True)
            for y in (-depth / 2, depth / 2)
            for k, x in enumerate(xs)
        ]
    )
    for k in range(aisles):
        aisle = straight_line(plan.nodes[k].center, np.pi / 2, depth)
        plan.edges.append(PlanEdge(aisle, _AISLE, _LANE, _LANE, k, aisles + k))
        for node in (k, aisles + k):
            if k + 1 < aisles:
                access = straight_line(plan.nodes[node].center, 0.0, pitch)
                plan.edges.append(PlanEdge(access, _AISLE, _LANE, _LANE, node, node + 1))
    gate = int(rng.integers(0, aisles))
    length = rng.uniform(26, 40)
    junction, junction_node = np.array([xs[gate], -depth / 2 - length]), 2 * aisles
    plan.nodes.append(PlanNode(junction, corner=8.0))
    driveway = straight_line(junction, np.pi / 2, length)
    plan.edges.append(PlanEdge(driveway, _AISLE, _LANE, _LANE, junction_node, gate, SIDE_STREET_RANK))
    profile = RoadProfile(float(style.limits[0]) * MPS_PER_MPH, 3.4, sidewalk=True)
    lanes = Carriageway(int(rng.integers(1, 3)))
    for heading in (0.0, np.pi):
        street = straight_line(junction, heading, MAP_RADIUS)
        plan.edges.append(PlanEdge(street, profile, lanes, lanes, junction_node, None))
    net = build_network(plan, rng)
    for x in xs:
        for side in (-1, 1):
            center = np.array([x + side * (_AISLE.width + _BAY_LENGTH / 2), 0.0])
            heading = 0.0 if rng.random() < 0.5 else np.pi
            net.parking_rows.append(ParkingRow(center, np.pi / 2, depth - _ROW_MARGIN, heading))
    return net
