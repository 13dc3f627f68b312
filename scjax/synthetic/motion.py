"""Worlds in motion: a ``Log`` of ten seconds around every moment of a world."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from scjax.scene import NO_EGO, AgentType, Log, Signal
from scjax.synthetic import actors, domains
from scjax.synthetic.actors import Actors
from scjax.synthetic.recording import map_lanes, world_metadata
from scjax.synthetic.setting import Setting, draw_setting
from scjax.synthetic.stage import play
from scjax.synthetic.traffic import TIME_STEP

SECONDS_BACK, SECONDS_AHEAD = 2.0, 8.0  # of a log, from its moment
STEP = 0.1  # s between the steps of a log
_EGO_RADIUS = 70.0  # m from the center of the map
_MAX_TANGENT = 2.5  # of the distance between two snapshots; a vehicle that brakes hard must not turn back
_SUBSTEPS = round(TIME_STEP / STEP)


class _Snapshot(NamedTuple):
    """All agents at one time, and the ``Signal`` of every lane."""

    agents: Actors
    signals: np.ndarray


def world_logs(seed: int, k: int, events: Sequence[str] = (), event_share: float = domains.EVENT_SHARE) -> list[Log]:
    """The logs of world ``k`` of ``seed``, one for each moment: 2 s back and 8 s ahead at 10 Hz.

    Times count from the moment, which is that of the world's scenes. The ego of a log is a vehicle that is there all
    the time; a log without such a vehicle has none.

    Args:
      events, event_share: as for ``make_world``.

    Raises:
      ValueError: if one of the numbers is negative.
    """
    setting = draw_setting(seed, k, events, event_share)
    snapshots: dict[int, list[_Snapshot]] = {}
    for moment, time in play(setting.stage, setting.rng, SECONDS_AHEAD):
        if -SECONDS_BACK <= time <= SECONDS_AHEAD:
            snapshot = _Snapshot(setting.stage.agents(), setting.recorded_signals())
            snapshots.setdefault(moment, []).append(snapshot)
    flip = -1.0 if setting.domain.left_hand else 1.0
    lanes = map_lanes(setting.net, setting.ground, flip)
    return [
        dataclasses.replace(_make_log(setting, parts, moment, flip), lanes=lanes) for moment, parts in snapshots.items()
    ]


def _make_log(setting: Setting, snapshots: list[_Snapshot], moment: int, flip: float) -> Log:
    """The log of the snapshots, ``TIME_STEP`` apart, without lanes."""
    ids, valid, table, states = _tracks(snapshots)
    steps = (len(snapshots) - 1) * _SUBSTEPS + 1
    whole, part = np.divmod(np.arange(steps), _SUBSTEPS)
    share = part / _SUBSTEPS
    after = np.minimum(whole + (part > 0), len(snapshots) - 1)
    seen = valid[:, whole] & valid[:, after]
    positions = _interpolate(states, whole, after, share)
    first, last = states[:, whole], states[:, after]
    turn = np.angle(np.exp(1j * (last[..., 2] - first[..., 2])))
    headings = np.angle(np.exp(1j * (first[..., 2] + share * turn)))
    velocities = first[..., 3:5] + share[:, None] * (last[..., 3:5] - first[..., 3:5])
    heights = setting.ground.height(positions.reshape(-1, 2)).reshape(seen.shape) + states[:, whole, 5]
    mirror = np.array([1.0, flip])
    signals = np.stack([snapshot.signals for snapshot in snapshots], 1)
    signal_lanes = np.flatnonzero((signals != Signal.UNKNOWN).any(1))
    center = np.column_stack([(positions * mirror).reshape(-1, 2), heights.ravel()]).reshape(*seen.shape, 3)
    center[..., 2] += table.sizes[:, None, 2] / 2
    metadata = world_metadata(setting.name, setting.domain.name)
    return Log(
        timestamps=np.arange(steps) * STEP - SECONDS_BACK,
        object_ids=tuple(map(str, ids)),
        object_types=table.types.astype(int),
        valid=seen,
        positions=np.where(seen[..., None], center, 0.0),
        headings=np.where(seen, flip * headings, 0.0),
        velocities=np.where(seen[..., None], velocities * mirror, 0.0),
        sizes=table.sizes,
        ego_index=_choose_ego(table, seen, positions),
        signal_lane_ids=tuple(map(str, signal_lanes)),
        signal_states=signals[signal_lanes][:, whole].astype(np.int8),
        signal_positions=np.full((len(signal_lanes), 3), np.nan),
        lanes=(),
        has_topology=True,
        metadata=dataclasses.replace(metadata, scene_id=f"{setting.name}-{moment}"),
    )


def _tracks(snapshots: list[_Snapshot]) -> tuple[np.ndarray, np.ndarray, Actors, np.ndarray]:
    """Numbers of all agents, when they are there, one row of ``Actors`` for each, and their states.

    States [agents, snapshots, 6] are position, heading, velocity and level. Of two agents that overlap at some time the
    later one is left out.
    """
    dropped = [
        snapshot.agents.ids[actors.overlapping_actors(snapshot.agents, margin=0.0)[:, 1]] for snapshot in snapshots
    ]
    everyone = np.concatenate([snapshot.agents.ids for snapshot in snapshots])
    kept = ~np.isin(everyone, np.concatenate(dropped))
    ids, first = np.unique(everyone[kept], return_index=True)
    table = actors.concatenate_actors([snapshot.agents for snapshot in snapshots]).select(np.flatnonzero(kept)[first])
    valid = np.zeros((len(ids), len(snapshots)), bool)
    states = np.zeros((len(ids), len(snapshots), 6))
    for step, (agents, _) in enumerate(snapshots):
        row = np.minimum(np.searchsorted(ids, agents.ids), max(len(ids) - 1, 0))
        is_kept = ids[row] == agents.ids if len(ids) else np.zeros(len(agents), bool)
        row, agents = row[is_kept], agents.select(is_kept)
        valid[row, step] = True
        velocity = agents.speeds[:, None] * np.stack([np.cos(agents.headings), np.sin(agents.headings)], -1)
        states[row, step] = np.column_stack([agents.positions, agents.headings, velocity, agents.level])
    return ids, valid, table, states


def _interpolate(states: np.ndarray, whole: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Positions between snapshots by cubic curves with the velocities there [agents, steps, 2]."""
    t = share[:, None]
    first, last = states[:, whole], states[:, after]
    a, b = first[..., :2], last[..., :2]
    distance = np.linalg.norm(b - a, axis=-1, keepdims=True)
    u, v = (_shorten(TIME_STEP * state[..., 3:5], _MAX_TANGENT * distance) for state in (first, last))
    ends = (2 * t**3 - 3 * t**2 + 1) * a + (3 * t**2 - 2 * t**3) * b
    return np.where(share[:, None] > 0, ends + (t**3 - 2 * t**2 + t) * u + (t**3 - t**2) * v, a)


def _shorten(vectors: np.ndarray, length: np.ndarray) -> np.ndarray:
    """``vectors`` [..., 2], none longer than ``length`` [..., 1]."""
    return vectors * np.minimum(1.0, length / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))


def _choose_ego(table: Actors, seen: np.ndarray, positions: np.ndarray) -> int:
    """The vehicle in traffic that is always there and drives furthest, near the center of the map if there is one."""
    distance = np.hypot(*np.moveaxis(positions, -1, 0)).max(1)
    fits = seen.all(1) & (table.types == AgentType.VEHICLE) & (table.lane >= 0) & (table.level == 0)
    near = fits & (distance < _EGO_RADIUS)
    rows = np.flatnonzero(near if near.any() else fits)
    if not len(rows):
        return NO_EGO
    return int(rows[np.hypot(*(positions[rows, -1] - positions[rows, 0]).T).argmax()])
