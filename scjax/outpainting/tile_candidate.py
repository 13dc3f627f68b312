"""One sampled window as a tile of a map: new lanes that meet the known ones, new agents, faults and a score."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.outpainting.coverage import Coverage, OpenEnd, outward_heading
from scjax.outpainting.lane_merges import NO_ROW, DeadEnd, NewLanes, merge_beside, reach_border
from scjax.outpainting.linking import link_lanes, moved_lanes
from scjax.outpainting.measures import kinks_of
from scjax.outpainting.seams import is_duplicate
from scjax.outpainting.tile_agents import free_agents, sampled_agents
from scjax.outpainting.tile_signals import tile_signals
from scjax.outpainting.traffic_side import on_other_side
from scjax.outpainting.window import KnownWindow
from scjax.scene import AgentType, LaneNeighbor, Link, Map, MapLane, Scene, Signal
from scjax.scene.polyline import cumulative_length, thinned

_SHORTEST = 0.5  # m of a new lane
_LEAST_STEP = 0.5  # m between points of a lane; nearer ones give it a direction by chance
_COVERED = 0.6  # share of a lane's points on covered ground, from which it is left out
_DEEP = 1.0  # m inside a covered tile
_MERGE = 0.5  # score of a lane that leads into the one beside it
_TIGHT = 2.0  # m in which lanes that bend by 25 degrees are too tight for cars
_VEHICLES = 5  # so many new vehicles are better than fewer


@dataclasses.dataclass(frozen=True)
class TileCandidate:
    """What a sample adds to a map.

    Attributes:
      map: the new lanes, signals and agents, in the frame of the map; no tiles.
      connections: pairs of lane ids, the second follows the first, one of them in the map.
      faults: what is wrong, in words; empty if nothing is.
      score: higher is better.
      dead_lane_ids: lanes of the older map that lead nowhere now and can be left out.
      moved: lanes of the older map, by their ids, whose ends are brought to those of new lanes.
    """

    map: Map
    connections: tuple[tuple[str, str], ...]
    faults: tuple[str, ...]
    score: float
    dead_lane_ids: tuple[str, ...] = ()
    moved: Mapping[str, MapLane] = dataclasses.field(default_factory=dict)


def tile_candidate(sample: Scene, window: KnownWindow, coverage: Coverage, name: str) -> TileCandidate:
    """The new part of a sampled window.

    Args:
      sample: an unpadded scene whose first elements are those of ``window``.
      coverage: of the map, without the front half of the window if nothing is known there.
      name: begins the ids of the new lanes and agents.
    """
    count, pose = len(window.scene.lane_mask), window.pose
    lanes, links = pose.to_map(np.asarray(sample.lanes)[count:]), np.asarray(sample.links)
    kept = _are_new(lanes, window.near, coverage)
    rows = np.add(np.flatnonzero(kept), count)
    lines = [thinned(lanes[row], _LEAST_STEP) for row in np.flatnonzero(kept)]
    agents, types = sampled_agents(sample, window)
    linked, agents = link_lanes(lines, _inner_edges(links[np.ix_(rows, rows)]), window.open_ends, agents, types)
    new = NewLanes(linked.lines, rows.tolist(), linked.edges, linked.joints)
    merges = len(new.lines)
    dead_ends = merge_beside(new, reach_border(new, _dead_ends(new, window), window.is_dead))
    merges = sum(row == NO_ROW for row in new.rows[merges:])
    dead, unmet = window.dead_turns.of([one.end for one in dead_ends if one.lane is None])
    inside = sum(one.lane is not None for one in dead_ends)
    faults, penalty = _faults(new, window, len(unmet), inside)
    new_map = _map_of(sample, new, window, free_agents(agents, types, window, coverage), name)
    ids = [lane.id for lane in new_map.lanes]
    pairs = [
        (joint.open_end.lane_id, ids[joint.lane]) if joint.at_start else (ids[joint.lane], joint.open_end.lane_id)
        for joint in new.joints
    ]
    vehicles = int((new_map.agent_types == AgentType.VEHICLE).sum())
    score = 0.2 * min(vehicles, _VEHICLES) - penalty - 1.0 * len(dead) - _MERGE * merges
    moved = moved_lanes(new.lines, new.joints, window.map.lane_by_id)
    return TileCandidate(new_map, tuple(pairs), faults, score, tuple(sorted(dead)), moved)


def _are_new(lanes: Float64[np.ndarray, "lanes points 3"], near: Map, coverage: Coverage) -> Bool[np.ndarray, " lanes"]:
    """Lanes of some length on uncovered ground that are not there already."""
    if not len(lanes):
        return np.zeros(0, bool)
    covered = coverage.contains(lanes[..., :2].reshape(-1, 2), _DEEP).reshape(lanes.shape[:2]).mean(-1)
    others = [lane.points for lane in near.lanes]
    long_enough = np.array([cumulative_length(lane)[-1] >= _SHORTEST for lane in lanes])
    kept = (covered < _COVERED) & long_enough
    for row in np.flatnonzero(kept):
        kept[row] = not is_duplicate(lanes[row], others).any()
    return kept


def _inner_edges(links: Int[np.ndarray, "lanes lanes"]) -> list[tuple[int, int]]:
    return [(int(a), int(b)) for a, b in np.argwhere(links == Link.PREDECESSOR) if a != b]


def _dead_ends(new: NewLanes, window: KnownWindow) -> list[DeadEnd]:
    """Ends of lanes of the map and of the tile that nothing continues on ground that is covered with the tile."""
    met = {(joint.open_end.lane_id, joint.open_end.is_start) for joint in new.joints}
    ends = [DeadEnd(end) for end in window.open_ends if (end.lane_id, end.is_start) not in met]
    joined = {(joint.lane, joint.at_start) for joint in new.joints}
    joined |= {(a, False) for a, _ in new.edges} | {(b, True) for _, b in new.edges}
    for lane, line in enumerate(new.lines):
        for is_start in (True, False):
            heading = outward_heading(line, is_start)
            if (lane, is_start) not in joined and heading is not None:
                ends.append(DeadEnd(OpenEnd("", is_start, line[0 if is_start else -1], heading, False), lane))
    return [one for one in ends if window.is_dead(one.end.place[:2], one.end.outward)]


def _faults(new: NewLanes, window: KnownWindow, unmet: int, inside: int) -> tuple[tuple[str, ...], float]:
    """What is wrong with new lanes, and how bad that is: lower is better.

    Args:
      unmet, inside: dead ends of lanes of the map, and of new lanes.
    """
    kinked, tight = (sum(len(kinks_of(line, within)) > 0 for line in new.lines) for within in (1.0, _TIGHT))
    lines = [*new.lines, *(lane.points for lane in window.near.lanes)]
    swapped = int(on_other_side(lines, window.keeps_right)[: len(new.lines)].sum())
    overlap = window.brings_overlap(new.lines)
    faults = []
    if unmet:
        faults.append(f"{unmet} lanes do not go on")
    if inside:
        faults.append(f"{inside} lanes end or begin inside")
    if kinked:
        faults.append(f"{kinked} lanes bend sharply")
    if swapped:
        faults.append(f"{swapped} lanes are on the oncoming side")
    if overlap:
        faults.append("lanes lie on each other")
    return tuple(faults), 5.0 * unmet + 3.0 * inside + 1.0 * kinked + 0.5 * tight + 0.5 * swapped + 1.0 * overlap


def _map_of(
    sample: Scene,
    new: NewLanes,
    window: KnownWindow,
    agents_and_types: tuple[np.ndarray, np.ndarray],
    name: str,
) -> Map:
    """New lanes, signals and agents as a map."""
    ids = [f"{name}.lane-{row}" for row in range(len(new.lines))]
    links = np.asarray(sample.links)
    beside = [
        [
            [ids[k] for k, other in enumerate(new.rows) if NO_ROW not in (row, other) and links[other, row] == link]
            for link in (Link.LEFT, Link.RIGHT)
        ]
        for row in new.rows
    ]
    lanes = tuple(
        MapLane(
            id=ids[row],
            lane_type=None,
            points=line,
            predecessors=tuple(ids[a] for a, b in new.edges if b == row),
            successors=tuple(ids[b] for a, b in new.edges if a == row),
            left_neighbors=tuple(LaneNeighbor(other) for other in beside[row][0]),
            right_neighbors=tuple(LaneNeighbor(other) for other in beside[row][1]),
        )
        for row, line in enumerate(new.lines)
    )
    states = dict(zip(window.map.signal_lane_ids, window.map.signal_states.tolist(), strict=True))
    signals = tile_signals(np.asarray(sample.signals, np.int32), new, window.near.lane_by_id, states)
    lit = np.flatnonzero(signals != Signal.UNKNOWN)
    agents, types = agents_and_types
    return Map(
        lanes=lanes,
        signal_lane_ids=tuple(ids[row] for row in lit),
        signal_states=signals[lit],
        signal_positions=np.array([new.lines[int(row)][0] for row in lit]).reshape(-1, 3),
        agent_ids=tuple(f"{name}.agent-{row}" for row in range(len(agents))),
        agent_types=types,
        agents=agents,
    )
