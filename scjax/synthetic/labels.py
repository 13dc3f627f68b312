"""Labels of synthetic scenes: what a scene shows by construction; None where the construction leaves it open."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from scjax.scene import TILE_SIZE, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.synthetic.network import Junction
from scjax.synthetic.world import Ego, World

LayoutLabel = Literal["four-way", "T", "Y", "roundabout", "straight", "curve"]

_HALF_TILE = TILE_SIZE / 2
_MAX_CENTER_DISTANCE = 20.0  # m from the ego to the center of a junction that the scene shows as a whole
_RING_MARGIN = 8.0  # m from the ring of a roundabout to the end of its arms, about
_OUTSIDE_MARGIN = 4.0  # m outside the window, beyond which a junction is not visible at all
_ROAD_DISTANCE = 30.0  # m behind and ahead of the ego that decide on the shape of its road
_ROAD_SAMPLES = 13
_MAX_STRAIGHT_TURN, _MIN_CURVE_TURN = np.deg2rad(9.0), np.deg2rad(27.0)
_SIGNAL_LABELS = {Signal.GO: "green", Signal.CAUTION: "yellow", Signal.STOP: "red"}
_JUNCTION_LABELS: dict[str, LayoutLabel] = {
    "four-way": "four-way",
    "T": "T",
    "Y": "Y",
    "driveway": "T",
    "roundabout": "roundabout",
}
_RARE_LAYOUTS = ("roundabout", "curve")

ToEgoFrame = Callable[[np.ndarray], tuple[float, float]]
"""Maps a position in the world [m] to the frame of the ego [m]."""


@dataclasses.dataclass(frozen=True)
class SceneLabel:
    """Labels of one scene; the field names are the keys of the JSON form.

    Attributes:
      domain, network: domain and network type of the world.
      layout: type of the only junction, or shape of the road.
      signal: state of the ego's traffic light; "" without a recorded light ahead.
      event: the rare event.
      about: position of the agent that the event is about, in the frame of the ego [m].
    """

    domain: str
    network: str
    layout: LayoutLabel | None
    signal: str | None
    event: str | None
    about: tuple[float, float] | None

    @property
    def rare(self) -> bool:
        """Whether few scenes show this: an event, a roundabout, a curve or a yellow light."""
        return self.event is not None or self.layout in _RARE_LAYOUTS or self.signal == "yellow"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return dataclasses.asdict(self)


def label_scene(world: World, ego: Ego) -> SceneLabel:
    """Labels of the scene around ``ego``."""
    moment = world.moments[ego.moment]
    cos, sin = np.cos(moment.headings[ego.agent]), np.sin(moment.headings[ego.agent])
    flip = -1.0 if world.mirrored else 1.0

    def to_ego_frame(position: np.ndarray) -> tuple[float, float]:
        x, y = position - moment.positions[ego.agent]
        return float(cos * x + sin * y), float(flip * (cos * y - sin * x))

    return SceneLabel(
        domain=world.domain,
        network=world.network_type,
        layout=_layout_label(world, ego, to_ego_frame),
        signal=_signal_label(world, ego),
        event=ego.event,
        about=to_ego_frame(moment.positions[ego.event_agent]) if ego.event_agent >= 0 else None,
    )


def _layout_label(world: World, ego: Ego, to_ego_frame: ToEgoFrame) -> LayoutLabel | None:
    labels: list[LayoutLabel] = []
    for junction in world.net.junctions:
        distance = max(map(abs, to_ego_frame(junction.center)))
        if distance > _HALF_TILE + junction.radius + _OUTSIDE_MARGIN:
            continue
        label = _junction_label(junction, distance)
        if label is None:
            return None
        labels.append(label)
    if labels:
        return labels[0] if len(labels) == 1 else None
    for lane in world.net.lanes:  # a lane starts or ends
        if len(lane.successors) > 1 and max(map(abs, to_ego_frame(lane.points[-1]))) < _HALF_TILE + _OUTSIDE_MARGIN:
            return None
    headings = _headings_along_road(world, ego)
    if headings is None:
        return None
    if np.ptp(headings) < _MAX_STRAIGHT_TURN:
        return "straight"
    return "curve" if abs(headings[-1] - headings[0]) > _MIN_CURVE_TURN else None


def _junction_label(junction: Junction, distance: float) -> LayoutLabel | None:
    """Label of a junction at ``distance`` (Chebyshev) from the ego [m]; None if it is not visible as a whole."""
    if junction.type == "roundabout":
        is_cut = distance + junction.radius - _RING_MARGIN > _HALF_TILE
    else:
        is_cut = distance > _MAX_CENTER_DISTANCE
    # On one-way roads it depends on the viewer which road is the side road.
    is_two_way = all(arm.inbound and arm.outbound for arm in junction.arms)
    return None if is_cut or not is_two_way else _JUNCTION_LABELS.get(junction.type)


def _headings_along_road(world: World, ego: Ego) -> np.ndarray | None:
    """Unwrapped headings of the ego's lane from 30 m behind to 30 m ahead [rad]; None where the lane is shorter."""
    lanes = world.lanes
    moment = world.moments[ego.moment]
    lane = int(moment.lane[ego.agent])
    points = lanes.points[lanes.start[lane] : lanes.start[lane] + lanes.count[lane]]
    point = float(np.linalg.norm(points - moment.positions[ego.agent], axis=-1).argmin())
    along = point * (lanes.length[lane] / (lanes.count[lane] - 1))
    if along < _ROAD_DISTANCE or lanes.length[lane] - along < _ROAD_DISTANCE:
        return None
    positions = np.linspace(along - _ROAD_DISTANCE, along + _ROAD_DISTANCE, _ROAD_SAMPLES)
    _, headings = lanes.poses_at(np.full(_ROAD_SAMPLES, lane), positions)
    return headings[0] + np.concatenate([[0.0], np.cumsum(wrap_to_pi(np.diff(headings)))])


def _signal_label(world: World, ego: Ego) -> str | None:
    """State of the connectors after the ego's lane; None on a connector, or where the states differ."""
    signals, lanes, moment = world.signals[ego.moment], world.lanes, world.moments[ego.moment]
    lane = int(moment.lane[ego.agent])
    if not signals.any():
        return ""
    end = lanes.points[lanes.start[lane] + lanes.count[lane] - 1]
    if lanes.junction[lane] >= 0 or np.hypot(*(end - moment.positions[ego.agent])) > _MAX_CENTER_DISTANCE:
        return None
    states = {int(signals[k]) for k in lanes.successors[lane] if k >= 0}
    if states <= {int(Signal.UNKNOWN)}:
        return None
    return _SIGNAL_LABELS[Signal(states.pop())] if len(states) == 1 else None
