"""Plan of a street network: nodes where roads meet and the roads between them; builds the network of lanes."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from scjax.synthetic.curves import Line, line_length, slice_line
from scjax.synthetic.junctions import InfeasiblePlan, add_connectors, exits_by_turn, stop_distances
from scjax.synthetic.network import Arm, Junction, JunctionType, Network
from scjax.synthetic.roads import Carriageway, RoadProfile, add_road, add_turning_circle, attach_to_arm
from scjax.synthetic.roundabouts import RING_CLEARANCE, add_roundabout, outer_ring_radius
from scjax.synthetic.signals import plan_phases

_DIRECTION_DISTANCE = 8.0  # m from a node where the direction of a road is measured
_MIN_ROAD_LENGTH = 4.0  # m between two junctions
_MAX_CORNER_VARIATION = 1.5  # m
_ROAD_CLEARANCE = 1.75  # m between the centerlines of lanes of different roads
_MAX_CELLS = 10_000  # of a grid over the map, along one axis
_MAX_Y_GAP = np.deg2rad(155)  # between the arms of a Y-junction


@dataclasses.dataclass
class PlanNode:
    """A junction.

    Attributes:
      center: [m].
      signals: whether it has traffic signals.
      ring_radius: of the innermost lane of a roundabout [m], 0 for other junctions.
      ring_lanes: of the roundabout.
      corner: smallest radius of the curbs [m].
      is_driveway: whether a private road ends here.
    """

    center: np.ndarray
    signals: bool = False
    ring_radius: float = 0.0
    ring_lanes: int = 1
    corner: float = 6.5
    is_driveway: bool = False


@dataclasses.dataclass
class PlanEdge:
    """A road.

    Attributes:
      line: reference line [m].
      profile: what its lanes share.
      forward, backward: the carriageways along the line and against it.
      start_node, end_node: indices of nodes; None at the border of the map.
      rank: right of way without signals; lower goes first.
      turning_circle: radius of a loop at the end, for traffic to turn back [m]; 0 for none.
    """

    line: Line
    profile: RoadProfile
    forward: Carriageway
    backward: Carriageway
    start_node: int | None = None
    end_node: int | None = None
    rank: int = 0
    turning_circle: float = 0.0


@dataclasses.dataclass
class RoadPlan:
    """Nodes and the roads between them."""

    nodes: list[PlanNode] = dataclasses.field(default_factory=list)
    edges: list[PlanEdge] = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class _EdgeEnd:
    """The end of an edge at a node: direction seen from the node [rad], half widths of its carriageways [m]."""

    edge: int
    at_start: bool
    angle: float
    arriving: float
    leaving: float
    leaving_lanes: int
    rank: int


def build_network(plan: RoadPlan, rng: np.random.Generator) -> Network:
    """The network of a plan: roads up to the stop lines, then connectors, rings and signals.

    Raises:
      InfeasiblePlan: if an edge is too short for the junctions at its ends, if roads touch or are too
        wide to meet, or if an arm is no way on.
    """
    net = Network()
    for number in range(len(plan.nodes)):
        _remove_idle_pockets(plan, _ends_at(plan, number), has_ring=plan.nodes[number].ring_radius > 0)
    ends_of_nodes = [_ends_at(plan, number) for number in range(len(plan.nodes))]
    arms: dict[tuple[int, bool], Arm] = {}
    for node, ends in zip(plan.nodes, ends_of_nodes, strict=True):
        for end, distance in zip(ends, _stop_distances(node, ends, rng), strict=True):
            arms[end.edge, end.at_start] = Arm(end.angle, distance, rank=end.rank)
    edge_of_lane: list[int] = []
    for number, edge in enumerate(plan.edges):
        _add_edge(net, number, edge, arms.get((number, True)), arms.get((number, False)))
        edge_of_lane += [number] * (len(net.lanes) - len(edge_of_lane))
    if _roads_touch(net, edge_of_lane):
        raise InfeasiblePlan("two roads of the plan touch: widen the distances between them")
    for node, ends in zip(plan.nodes, ends_of_nodes, strict=True):
        node_arms = [arms[end.edge, end.at_start] for end in ends]
        radius = max(arm.stop_distance for arm in node_arms)
        junction = Junction(_junction_type(node, node_arms), node.center, radius, node_arms)
        net.junctions.append(junction)
        if node.ring_radius:
            add_roundabout(net, junction, node.ring_radius, node.ring_lanes)
        else:
            add_connectors(net, junction, rng)
            if node.signals:
                junction.phases = plan_phases(net, junction)
    return net


def _remove_idle_pockets(plan: RoadPlan, ends: list[_EdgeEnd], has_ring: bool) -> None:
    """Removes turn pockets at a node for turns that it does not have; a ring has none."""
    angles, has_exit = [end.angle for end in ends], [end.leaving_lanes > 0 for end in ends]
    for a, end in enumerate(ends):
        exits = exits_by_turn(angles, has_exit, a)
        edge, side = plan.edges[end.edge], "backward" if end.at_start else "forward"
        idle = {f"{turn}_pocket": 0.0 for turn in ("left", "right") if has_ring or not exits[turn]}
        setattr(edge, side, dataclasses.replace(getattr(edge, side), **idle))


def _roads_touch(net: Network, edge_of_lane: list[int]) -> bool:
    """Whether lanes of two edges come closer than about ``_ROAD_CLEARANCE``."""
    points = np.concatenate([lane.points for lane in net.lanes])
    edges = np.repeat(edge_of_lane, [len(lane.points) for lane in net.lanes])
    for shift in itertools.product((0.0, 0.5), repeat=2):  # two close points share a cell of one of the four grids
        cells = np.floor(points / (2 * _ROAD_CLEARANCE) + shift).astype(int)
        cell = cells[:, 0] * _MAX_CELLS + cells[:, 1]
        order = np.lexsort((edges, cell))
        if ((np.diff(cell[order]) == 0) & (np.diff(edges[order]) != 0)).any():
            return True
    return False


def _stop_distances(node: PlanNode, ends: list[_EdgeEnd], rng: np.random.Generator) -> list[float]:
    if node.ring_radius:
        return [outer_ring_radius(node.ring_radius, node.ring_lanes) + RING_CLEARANCE] * len(ends)
    variation = 0.0 if node.is_driveway else _MAX_CORNER_VARIATION
    corners = [node.corner + rng.uniform(0, variation) for _ in ends]
    angles, arriving = [end.angle for end in ends], [end.arriving for end in ends]
    return stop_distances(angles, arriving, [end.leaving for end in ends], corners)


def _add_edge(net: Network, number: int, edge: PlanEdge, start_arm: Arm | None, end_arm: Arm | None) -> None:
    """Adds the lanes of an edge between the stop lines of its arms."""
    length = line_length(edge.line)
    start = start_arm.stop_distance if start_arm else 0.0
    end = length - (end_arm.stop_distance if end_arm else 0.0)
    if end - start < _MIN_ROAD_LENGTH:
        raise InfeasiblePlan(f"edge {number} of the plan: {length:.0f} m are too short for the junctions at its ends")
    line = slice_line(edge.line, start, end)
    forward, backward = add_road(net, line, edge.profile, edge.forward, edge.backward)
    if start_arm:
        attach_to_arm(start_arm, backward, forward)
    if end_arm:
        attach_to_arm(end_arm, forward, backward)
    elif edge.turning_circle:
        add_turning_circle(net, forward.end[-1][0], backward.start[0], edge.turning_circle)


def _ends_at(plan: RoadPlan, number: int) -> list[_EdgeEnd]:
    """Ends of edges at a node, by angle."""
    ends = []
    for k, edge in enumerate(plan.edges):
        for at_start, node in ((True, edge.start_node), (False, edge.end_node)):
            if node != number:
                continue
            line = edge.line if at_start else edge.line[::-1]
            spacing = np.hypot(*(line[1] - line[0]))
            near = line[min(len(line) - 1, max(1, round(_DIRECTION_DISTANCE / spacing)))]
            angle = float(np.arctan2(*(near - line[0])[::-1]))
            arriving, leaving = (edge.backward, edge.forward) if at_start else (edge.forward, edge.backward)
            arriving_width = arriving.half_width(edge.profile, arriving=True)
            leaving_width = leaving.half_width(edge.profile, arriving=False)
            ends.append(_EdgeEnd(k, at_start, angle, arriving_width, leaving_width, leaving.lanes, edge.rank))
    return sorted(ends, key=lambda end: end.angle)


def _junction_type(node: PlanNode, arms: list[Arm]) -> JunctionType:
    if node.ring_radius:
        return "roundabout"
    if node.is_driveway and len(arms) < 4:
        return "driveway"
    if len(arms) == 4:
        return "four-way"
    if len(arms) != 3:
        return "complex"
    angles = sorted(arm.angle for arm in arms)
    gaps = [(b - a) % (2 * np.pi) for a, b in zip(angles, [*angles[1:], angles[0]], strict=True)]
    return "Y" if max(gaps) < _MAX_Y_GAP else "T"
