"""What a scene cut from a world shows, known from how it was made; no label where that is a matter of taste."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from scjax.language.road import wrap_to_pi
from scjax.scene import TILE_SIZE, Signal
from scjax.synthetic.world import Ego, World

LayoutLabel = Literal["four-way", "T", "roundabout", "straight", "curve"]

_HALF = TILE_SIZE / 2
_WELL_INSIDE = 20.0  # metres from the ego to the middle of a junction that is seen as a whole
_APRON = 8.0  # metres from the ring of a roundabout to where its arms end, about
_FAR = 4.0  # metres outside of the window from which a junction is not seen at all
_ALONG = 30.0  # metres before and behind the ego that decide whether its road bends
_STRAIGHT, _CURVED = np.deg2rad(9.0), np.deg2rad(27.0)
_SIGNALS = {Signal.GO: "green", Signal.CAUTION: "yellow", Signal.STOP: "red"}
_NAMES: dict[str, LayoutLabel] = {
    "four-way": "four-way", "T": "T", "Y": "T", "driveway": "T", "roundabout": "roundabout",
}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Label:
    """Labels of one scene; None: unclear.

    Attributes:
      domain, network: of the world. layout: the one junction that is seen, or how the road runs.
      signal: what the ego's light shows; "" without a light ahead that was recorded.
      event: the rare event in the scene; ``about`` is the place of who it is about, in the ego's frame [m].
    """

    domain: str
    network: str
    layout: LayoutLabel | None
    signal: str | None
    event: str | None
    about: tuple[float, float] | None

    @property
    def rare(self) -> bool:
        """Whether few scenes show this: an event, a roundabout, a bend or a yellow light."""
        return self.event is not None or self.layout in ("roundabout", "curve") or self.signal == "yellow"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return dataclasses.asdict(self)


def label(world: World, ego: Ego) -> Label:
    """Labels of the scene around ``ego``."""
    moment = world.moments[ego.moment]
    cos, sin = np.cos(moment.headings[ego.agent]), np.sin(moment.headings[ego.agent])
    flip = -1.0 if world.mirrored else 1.0

    def local(place: np.ndarray) -> tuple[float, float]:
        x, y = place - moment.places[ego.agent]
        return float(cos * x + sin * y), float(flip * (cos * y - sin * x))

    about = local(moment.places[ego.about]) if ego.about >= 0 else None
    return Label(world.domain, world.kind, _layout(world, ego, local), _signal(world, ego), ego.event, about)


def _layout(world: World, ego: Ego, local) -> LayoutLabel | None:
    seen: list[LayoutLabel] = []
    for junction in world.net.junctions:
        distance = max(map(abs, local(junction.centre)))
        if distance > _HALF + junction.radius + _FAR:
            continue
        ring = junction.kind == "roundabout" and distance + junction.radius - _APRON > _HALF
        if ring or (distance > _WELL_INSIDE and junction.kind != "roundabout") or junction.kind not in _NAMES:
            return None
        if not all(arm.inbound and arm.outbound for arm in junction.arms):
            return None  # beside one-way roads it is a matter of taste what is a side road
        seen.append(_NAMES[junction.kind])
    if seen:
        return seen[0] if len(seen) == 1 else None
    for lane in world.net.lanes:  # a lane is added, or ends
        if len(lane.successors) > 1 and max(map(abs, local(lane.points[-1]))) < _HALF + _FAR:
            return None
    headings = _road_ahead(world, ego)
    if headings is None:
        return None
    turn, spread = abs(headings[-1] - headings[0]), np.ptp(headings)
    if spread < _STRAIGHT:
        return "straight"
    return "curve" if turn > _CURVED else None


def _road_ahead(world: World, ego: Ego) -> np.ndarray | None:
    """Directions of the ego's road from 30 m behind to 30 m ahead; None where it forks or ends before."""
    tracks = world.tracks
    moment = world.moments[ego.moment]
    lane = int(moment.lane[ego.agent])
    row = slice(tracks.start[lane], tracks.start[lane] + tracks.count[lane])
    at = float(np.linalg.norm(tracks.points[row] - moment.places[ego.agent], axis=-1).argmin())
    at *= tracks.length[lane] / (tracks.count[lane] - 1)
    if at < _ALONG or tracks.length[lane] - at < _ALONG:
        return None
    places = np.linspace(at - _ALONG, at + _ALONG, 13)
    _, headings = tracks.place(np.full(13, lane), places)
    return headings[0] + np.concatenate([[0.0], np.cumsum(wrap_to_pi(np.diff(headings)))])


def _signal(world: World, ego: Ego) -> str | None:
    """The light of the connectors that follow the ego's lane; unclear while it is on one of them."""
    lights, tracks = world.lights[ego.moment], world.tracks
    lane = int(world.moments[ego.moment].lane[ego.agent])
    if not lights.any():
        return ""
    moment = world.moments[ego.moment]
    end = tracks.points[tracks.start[lane] + tracks.count[lane] - 1]
    if tracks.junction[lane] >= 0 or np.hypot(*(end - moment.places[ego.agent])) > _WELL_INSIDE:
        return None
    states = {int(lights[k]) for k in tracks.successors[lane] if k >= 0}
    if states <= {int(Signal.UNKNOWN)}:
        return None
    return _SIGNALS[Signal(states.pop())] if len(states) == 1 else None
