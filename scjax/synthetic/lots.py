"""A parking lot beside a street: aisles between two lanes that run along it, with rows of bays."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import straight
from scjax.synthetic.network import MPS_OF_MPH, Lot, Network
from scjax.synthetic.plan import Edge, Node, Plan, build
from scjax.synthetic.roads import Profile, Side
from scjax.synthetic.towns import REACH, Style

_BAY = 5.2  # metres from the edge of an aisle to the far end of a bay
_AISLE = Profile(2.7, 2.8, walks=False)
_BOTH = Side(1)


def parking_lot(style: Style, rng: np.random.Generator) -> Network:
    """Two to four aisles; one of the two lanes that join them leads to a street."""
    aisles, depth = int(rng.integers(2, 5)), rng.uniform(34, 40)
    pitch = 2 * (_AISLE.width + _BAY) + rng.uniform(0.5, 1.5)
    xs = (np.arange(aisles) - (aisles - 1) / 2) * pitch
    plan = Plan([Node(np.array([x, y]), corner=2.0, driveway=True) for y in (-depth / 2, depth / 2) for x in xs])
    for k in range(aisles):
        plan.edges.append(Edge(straight(plan.nodes[k].centre, np.pi / 2, depth), _AISLE, _BOTH, _BOTH, k, aisles + k))
        for row in (k, aisles + k):
            if k + 1 < aisles:
                line = straight(plan.nodes[row].centre, 0.0, pitch)
                plan.edges.append(Edge(line, _AISLE, _BOTH, _BOTH, row, row + 1))
    gate = int(rng.integers(0, aisles))
    length = rng.uniform(26, 40)
    street = np.array([xs[gate], -depth / 2 - length])
    plan.nodes.append(Node(street, corner=4.0))
    plan.edges.append(Edge(straight(street, np.pi / 2, length), _AISLE, _BOTH, _BOTH, 2 * aisles, gate, 3))
    profile = Profile(float(style.limits[0]) * MPS_OF_MPH, 3.4, walks=True)
    lanes = Side(int(rng.integers(1, 3)))
    for direction in (0.0, np.pi):
        plan.edges.append(Edge(straight(street, direction, REACH), profile, lanes, lanes, 2 * aisles, None))
    net = build(plan, rng)
    for x in xs:
        for side in (-1, 1):
            middle = np.array([x + side * (_AISLE.width + _BAY / 2), 0.0])
            net.lots.append(Lot(middle, np.pi / 2, depth - 12.0, 0.0 if rng.random() < 0.5 else np.pi))
    return net
