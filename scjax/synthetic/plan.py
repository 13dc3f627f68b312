"""Plan of a town: where roads meet and what they are like; built into a network of lanes."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.synthetic.curves import Line, length_of, part
from scjax.synthetic.junctions import connect, stop_distances
from scjax.synthetic.network import Arm, Junction, JunctionKind, Network
from scjax.synthetic.roads import Profile, Side, add_road, arrive
from scjax.synthetic.roundabouts import add_ring
from scjax.synthetic.signals import plan_phases

_NEAR = 8.0  # metres from a node at which a road's direction there is taken


class TooTight(Exception):
    """The junctions of a plan leave no room for a road between them."""


@dataclasses.dataclass
class Node:
    """A junction to be.

    ``ring``: radius of a roundabout [m], 0 for none; ``corner``: room at corners [m]; ``driveway``: of a private way.
    """

    centre: np.ndarray
    signals: bool = False
    ring: float = 0.0
    corner: float = 4.0
    driveway: bool = False


@dataclasses.dataclass
class Edge:
    """A road along ``line``, from node ``a`` to node ``b``; None: it comes from or goes out of the map.

    ``out`` is the direction along the line, ``back`` the other one; ``rank`` 3 yields to 0 where there are no signals.
    """

    line: Line
    profile: Profile
    out: Side
    back: Side
    a: int | None = None
    b: int | None = None
    rank: int = 0


@dataclasses.dataclass
class Plan:
    """Nodes and the roads between them."""

    nodes: list[Node] = dataclasses.field(default_factory=list)
    edges: list[Edge] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class _End:
    """The end of an edge at a node, seen from the node outwards."""

    edge: int
    at_start: bool
    angle: float
    arriving: float
    leaving: float
    rank: int
    stop: float = 0.0


def build(plan: Plan, rng: np.random.Generator) -> Network:
    """The network of a plan: roads cut back from the nodes, then connectors, rings and signals.

    Raises:
      TooTight: if an edge is too short.
    """
    net = Network()
    ends = [_ends_at(plan, number) for number in range(len(plan.nodes))]
    for node, met in zip(plan.nodes, ends, strict=True):
        if node.ring:
            for end in met:
                end.stop = node.ring + 9.0
            continue
        corners = [node.corner + rng.uniform(0, 2.5) for _ in met]
        stops = stop_distances(
            [end.angle for end in met], [end.arriving for end in met], [end.leaving for end in met], corners
        )
        for end, stop in zip(met, stops, strict=True):
            end.stop = stop
    arms = {(end.edge, end.at_start): Arm(end.angle, end.stop, rank=end.rank) for met in ends for end in met}
    for number, edge in enumerate(plan.edges):
        start, finish = arms.get((number, True)), arms.get((number, False))
        first, total = start.stop if start else 0.0, length_of(edge.line)
        last = total - (finish.stop if finish else 0.0)
        if last - first < 4.0:
            raise TooTight(f"edge {number} of the plan: {total:.0f} m are too short for the junctions at its ends")
        out, back = add_road(net, part(edge.line, first, last), edge.profile, edge.out, edge.back)
        if start:
            arrive(start, back, out)
        if finish:
            arrive(finish, out, back)
    for node, met in zip(plan.nodes, ends, strict=True):
        own = [arms[end.edge, end.at_start] for end in met]
        junction = Junction(_kind(node, own), node.centre, max(arm.stop for arm in own), own)
        net.junctions.append(junction)
        if node.ring:
            add_ring(net, junction, node.ring)
        else:
            connect(net, junction, rng)
            if node.signals:
                junction.phases = plan_phases(net, junction)
    return net


def _ends_at(plan: Plan, number: int) -> list[_End]:
    """Ends of edges at a node, by angle."""
    found = []
    for k, edge in enumerate(plan.edges):
        for at_start, node in ((True, edge.a), (False, edge.b)):
            if node != number:
                continue
            line = edge.line if at_start else edge.line[::-1]
            near = line[min(len(line) - 1, max(1, round(_NEAR / np.hypot(*(line[1] - line[0])))))]
            angle = float(np.arctan2(*(near - line[0])[::-1]))
            arriving, leaving = (edge.back, edge.out) if at_start else (edge.out, edge.back)
            found.append(
                _End(
                    k, at_start, angle, arriving.half_width(edge.profile, True),
                    leaving.half_width(edge.profile, False), edge.rank,
                )
            )  # fmt: skip
    return sorted(found, key=lambda end: end.angle)


def _kind(node: Node, arms: list[Arm]) -> JunctionKind:
    if node.ring:
        return "roundabout"
    if node.driveway and len(arms) < 4:
        return "driveway"
    if len(arms) == 4:
        return "four-way"
    if len(arms) != 3:
        return "complex"
    angles = sorted(arm.angle for arm in arms)
    gaps = [(b - a) % (2 * np.pi) for a, b in zip(angles, [*angles[1:], angles[0]], strict=True)]
    return "Y" if max(gaps) < np.deg2rad(155) else "T"
