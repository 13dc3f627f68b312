"""A synthetic world: a map, its traffic at some moments, and the vehicles whose surroundings become scenes.

World k of a seed depends on these two numbers only. ``scjax.synthetic.recording`` turns it into a ``Log``, so that
its scenes take the same way as recorded ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import domains
from scjax.synthetic.actors import Actors
from scjax.synthetic.events import StagedEvent
from scjax.synthetic.ground import Ground
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network
from scjax.synthetic.setting import VERSION, draw_setting
from scjax.synthetic.stage import play, without_overlaps

MAX_SCENES = 15  # per world
_EGOS = 2  # stream of random numbers for the choice of egos
_EGO_DISTANCE = 11.0  # m between the egos of a world, over all moments
_EVENT_EGO_DISTANCE = _EGO_DISTANCE / 3  # m for egos that see an event
_JUNCTION_DISTANCE = 30.0  # m, recordings dwell close to junctions
_STANDING_SPEED = 0.5  # m/s
_STANDING_SHARE = 0.4  # of the standing vehicles that may become egos
_ELSEWHERE_SHARE = 0.3  # of the vehicles further from junctions that become egos
_MAX_EGO_RADIUS = 78.0  # m from the center of the map
_EVENT_ALONG, _EVENT_LATERAL = 21, 20  # m from an ego to an event that its scene shows
_MAX_EVENT_EGOS = 4  # per moment


@dataclasses.dataclass(frozen=True)
class Ego:
    """A scene of a world.

    Attributes:
      moment, agent: indices of the moment and of the ego in it.
      event: the rare event that the scene shows.
      event_agent: index of the agent that the event is about; -1 without an event.
    """

    moment: int
    agent: int
    event: str | None = None
    event_agent: int = -1


@dataclasses.dataclass(frozen=True)
class World:
    """A world in right-hand traffic.

    Attributes:
      name: "<domain>-<seed>-<number>".
      domain, network_type: of the map.
      mirrored: whether its scenes are mirrored for left-hand traffic.
      net, lanes: the road network, and its lanes as arrays.
      ground: the terrain.
      moments: all agents at each moment.
      signals: ``Signal`` of every lane at each moment [lanes].
      egos: the scenes.
    """

    name: str
    domain: str
    network_type: str
    mirrored: bool
    net: Network
    lanes: LaneArrays
    ground: Ground
    moments: tuple[Actors, ...]
    signals: tuple[np.ndarray, ...]
    egos: tuple[Ego, ...]


def make_world(seed: int, k: int, events: Sequence[str] = (), event_share: float = domains.EVENT_SHARE) -> World:
    """World ``k`` of ``seed``.

    Args:
      events: names of events; the world shows one of them if it has a place for it. Empty: any event or none.
      event_share: probability of an event if ``events`` is empty.

    Raises:
      ValueError: if one of the numbers is negative.
    """
    setting = draw_setting(seed, k, events, event_share)
    stage, rng = setting.stage, np.random.default_rng([VERSION, seed, k, _EGOS])
    moments, signals, egos = [], [], []
    for moment, time in play(stage, setting.rng):
        if time == 0.0:
            moments.append(without_overlaps(stage.agents()))
            signals.append(setting.recorded_signals())
            egos += _draw_egos(moments[-1], setting.net, moment, stage.event, rng)
    return World(
        name=setting.name,
        domain=setting.domain.name,
        network_type=setting.network_type,
        mirrored=setting.domain.left_hand,
        net=setting.net,
        lanes=setting.lanes,
        ground=setting.ground,
        moments=tuple(moments),
        signals=tuple(signals),
        egos=tuple(_select_egos(egos, moments)),
    )


def _draw_egos(
    scene: Actors,
    net: Network,
    moment: int,
    event: StagedEvent | None,
    rng: np.random.Generator,
) -> list[Ego]:
    """Random vehicles on lanes close to the center of the map, most of them near junctions; first those with the event.

    Egos without the event are far from it, so that no scene shows an event without a label. The same holds for an
    event that the moment does not show as it should: a wrong-way driver who has just stopped is no ordinary traffic.
    """
    in_traffic = (scene.types == AgentType.VEHICLE) & (scene.lane >= 0) & (scene.level == 0)
    rows = np.flatnonzero(in_traffic & (np.hypot(*scene.positions.T) < _MAX_EGO_RADIUS))
    centers = np.array([junction.center for junction in net.junctions]).reshape(-1, 1, 2)
    near_junction = (np.linalg.norm(scene.positions[rows] - centers, axis=-1) < _JUNCTION_DISTANCE).any(0)
    share_elsewhere = _ELSEWHERE_SHARE if near_junction.any() else 1.0
    ordinary = near_junction | (rng.random(len(rows)) < share_elsewhere)
    ordinary &= (scene.speeds[rows] > _STANDING_SPEED) | (rng.random(len(rows)) < _STANDING_SHARE)
    ordinary = rows[ordinary]
    agent = None if event is None else event.find(scene)
    if event is None or agent is None:
        place = None if event is None else event.find_staged(scene)
        return [Ego(moment, int(row)) for row in ordinary[_is_far(scene, ordinary, event, place)]]
    direction = np.stack([np.cos(scene.headings), np.sin(scene.headings)], -1)[rows]
    offset = scene.positions[agent] - scene.positions[rows]
    along = (offset * direction).sum(-1)
    left = direction[:, 0] * offset[:, 1] - direction[:, 1] * offset[:, 0]
    in_view = (np.abs(along) < _EVENT_ALONG) & (np.abs(left) < _EVENT_LATERAL) & (rows != agent)
    witnesses = [int(row) for row in rows[in_view] if event.is_visible(scene, agent, int(row))]
    egos = [Ego(moment, row, event.event, agent) for row in witnesses[:_MAX_EVENT_EGOS]]
    return egos + [Ego(moment, int(row)) for row in ordinary[_is_far(scene, ordinary, event, agent)]]


def _is_far(scene: Actors, rows: np.ndarray, event: StagedEvent | None, place: int | None) -> np.ndarray:
    """Which agents ``rows`` see nothing of an event at agent ``place``; all if there is none [rows]."""
    if event is None or place is None:
        return np.ones(len(rows), bool)
    return np.hypot(*(scene.positions[rows] - scene.positions[place]).T) > event.clearance


def _select_egos(egos: list[Ego], moments: list[Actors]) -> list[Ego]:
    """At most ``MAX_SCENES`` egos at some distance from each other, those with events first."""
    counts = [0] * len(moments)
    number_in_moment = []
    for ego in egos:
        number_in_moment.append(counts[ego.moment])
        counts[ego.moment] += 1
    # One of each moment in turn.
    order = sorted(range(len(egos)), key=lambda i: (egos[i].event is None, number_in_moment[i]))
    selected, positions = [], np.zeros((0, 2))
    for ego in (egos[i] for i in order):
        position = moments[ego.moment].positions[ego.agent]
        min_distance = _EGO_DISTANCE if ego.event is None else _EVENT_EGO_DISTANCE
        if len(selected) < MAX_SCENES and (np.hypot(*(positions - position).T) >= min_distance).all():
            selected.append(ego)
            positions = np.concatenate([positions, position[None]])
    return selected
