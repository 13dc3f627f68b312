"""A log -> tracks at 5 Hz on a road network, with the lanes that each agent followed; NumPy on the host."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from scjax.data.agents import clean_agents
from scjax.models.behavior.config import STEP
from scjax.scene import OTHER_OBJECT, AgentType, Log
from scjax.sim.network_of_map import LanePoints
from scjax.sim.places import place_agents
from scjax.sim.preparation import prepare
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.routes import NUM_LANES, TURN_TEMPERATURE

BLOCK = 5  # steps after which agents are placed on lanes again
_NEAR = 3.0  # m from a lane, within which an agent has followed it
_LOOK = 60  # points of a lane that are compared with a track
_PARKED_REACH = 1.0  # m that parked vehicles may seem to move
_PADDING = 32  # agents are padded to multiples


@dataclasses.dataclass(frozen=True)
class LogTracks:
    """N agents over T steps of 0.2 s in the frame of the network, padded.

    Attributes:
      network: padded.
      signals: ``Signal`` at each step.
      x, y, heading, speed: as recorded [m, rad, m/s].
      valid: whether the agent was observed.
      length, width: [m]; kind: ``AgentType``.
      is_parked: never moves.
      lanes: route of each agent from each block of ``BLOCK`` steps on; -1 for none.
      along: of the agent on its first lane at the start of the block [m].
    """

    network: RoadNetwork
    signals: Int[np.ndarray, "T S"]
    x: Float[np.ndarray, "T N"]
    y: Float[np.ndarray, "T N"]
    heading: Float[np.ndarray, "T N"]
    speed: Float[np.ndarray, "T N"]
    valid: Bool[np.ndarray, "T N"]
    length: Float[np.ndarray, " N"]
    width: Float[np.ndarray, " N"]
    kind: Int[np.ndarray, " N"]
    is_parked: Bool[np.ndarray, " N"]
    lanes: Int[np.ndarray, "B N R"]
    along: Float[np.ndarray, "B N"]


def tracks_of(log: Log, rng: np.random.Generator) -> LogTracks:
    """The tracks of a log.

    Args:
      rng: draws the way of agents at forks that they do not reach.

    Raises:
      ValueError: the log has fewer than three steps of 0.2 s, other steps than 0.1 or 0.2 s, or no lane for cars.
    """
    stride = round(STEP / log.dt) if log.num_steps > 1 else 0
    if stride not in (1, 2) or abs(stride * log.dt - STEP) > 0.01 or log.num_steps <= 2 * stride:
        raise ValueError(f"{log.metadata.source_file or log.metadata.scene_id}: no log at 10 or 5 Hz of three steps")
    start = prepare(log, 0, rng)
    log = log[::stride]
    rows = np.flatnonzero((log.object_types != OTHER_OBJECT) & (log.valid.sum(1) > 2))
    types = log.object_types[rows]
    states = _states(log, rows, start.origin)
    lanes, along, parked = _places(start.lanes, start.network, states, types, log.valid[rows].T, rng)
    count = -(-max(len(rows), 1) // _PADDING) * _PADDING
    single = states.astype(np.float32)
    wide = {"x": single[..., 0], "y": single[..., 1], "speed": single[..., 3]}
    wide["heading"] = np.arctan2(single[..., 5], single[..., 4])
    return LogTracks(
        network=start.network,
        signals=log.signal_states.T.astype(np.int32),
        valid=_wide(log.valid[rows].T, count, False),
        length=_wide(single[0, :, 6], count, 1),
        width=_wide(single[0, :, 7], count, 1),
        kind=_wide(types.astype(np.int32), count, 0),
        is_parked=_wide(parked, count, True),
        lanes=np.stack([_wide(one.T, count, NONE).T for one in lanes]),
        along=_wide(along, count, 0),
        **{name: _wide(values, count, 0) for name, values in wide.items()},
    )


def _wide(values: np.ndarray, count: int, value: int | bool) -> np.ndarray:
    """The last axis padded to ``count``."""
    pad = [(0, 0)] * (values.ndim - 1) + [(0, count - values.shape[-1])]
    return np.pad(values, pad, constant_values=value)


def _states(log: Log, rows: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Columns of ``Scene.agents`` of each step [T, N, 9]; sizes are known at every step."""
    heading = log.headings[rows].T
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    velocity = log.velocities[rows].swapaxes(0, 1)
    types = log.object_types[rows]
    walks = (types == AgentType.PEDESTRIAN)[None]
    speed = np.where(walks, np.hypot(*velocity.transpose(2, 0, 1)), np.maximum((velocity * direction).sum(-1), 0.0))
    positions = log.positions[rows].swapaxes(0, 1) - origin
    sizes = np.broadcast_to(log.sizes[rows], (log.num_steps, len(rows), 3))
    states = np.concatenate([positions, speed[..., None], direction, sizes], -1)
    return np.stack([clean_agents(one, types)[0] for one in states])


def _places(
    points: LanePoints,
    network: RoadNetwork,
    states: np.ndarray,
    types: np.ndarray,
    valid: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lanes [B, N, R] and arc lengths [B, N] of every block, and who is parked [N]."""
    steps, count = valid.shape
    blocks = range(0, steps, BLOCK)
    lanes, along = np.full((len(blocks), count, NUM_LANES), NONE, np.int32), np.zeros((len(blocks), count), np.float32)
    first = valid.argmax(0)
    parked = types == AgentType.STATIC
    reach = np.zeros(count)
    for row in range(count):
        places = states[valid[:, row], row, :2]
        reach[row] = np.hypot(*(places - places[0]).T).max()
    for number, step in enumerate(blocks):
        # An agent that appears within the block has its lane from its first step.
        at = np.clip(first, step, min(step + BLOCK, steps) - 1)
        there = valid[at, np.arange(count)]
        here = states[at, np.arange(count)]
        rows = np.flatnonzero(there)
        found = place_agents(points, here[rows], types[rows])
        starts = (first[rows] >= step) & (first[rows] < step + BLOCK)
        parked[rows[starts & found.is_parked & (reach[rows] < _PARKED_REACH)]] = True
        along[number, rows] = found.along
        for row, lane in zip(rows, np.asarray(found.lane), strict=True):
            if lane != NONE:
                future = states[at[row] :, row, :2][valid[at[row] :, row]]
                lanes[number, row] = _route(points, network, int(lane), future, rng)
    return lanes, along, parked


def _route(
    points: LanePoints, network: RoadNetwork, lane: int, future: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The lanes from ``lane`` on that come nearest to positions [F, 2]; drawn where these end."""
    route = np.full(NUM_LANES, NONE, np.int32)
    for slot in range(NUM_LANES):
        route[slot] = lane
        successors = np.asarray(network.successors[lane])
        successors = successors[successors >= 0]
        if not len(successors):
            break
        lane = int(successors[0])
        if len(successors) > 1:
            lane = int(successors[_choose(points, network, successors, future, rng)])
    return route


def _choose(
    points: LanePoints, network: RoadNetwork, lanes: np.ndarray, future: np.ndarray, rng: np.random.Generator
) -> int:
    """Which of several lanes positions follow."""
    distances = []
    for lane in lanes:
        first = points.first[lane]
        line = points.points[first : first + min(int(points.intervals[lane]) + 1, _LOOK), :2]
        apart = future[:, None] - line[None]
        distances.append(np.sqrt((apart * apart).sum(-1)).min(1))
    table = np.array(distances)
    near = table.min(0) < _NEAR
    if near.any() and np.ptp(table[:, near].mean(1)) > 0.3:
        return int(table[:, near].mean(1).argmin())
    weights = np.exp(-np.abs(np.asarray(network.turn)[lanes]) / TURN_TEMPERATURE)
    return int(rng.choice(len(lanes), p=weights / weights.sum()))
