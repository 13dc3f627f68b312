"""The analysis of one scene: every part is worked out once, when it is first read."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float64

from scjax.language.analysis.agent_lanes import AgentLanes, relate_to_lanes
from scjax.language.analysis.crossings import Crossings, find_crossings
from scjax.language.analysis.crossroads import Crossroad, find_crossroads
from scjax.language.analysis.ego_route import EgoRoute, RoutePositions, find_ego_route, route_positions
from scjax.language.analysis.lane_lines import LaneLines, lane_lines
from scjax.language.analysis.layouts import has_dead_end, has_parking_rows, layout_names, road_shape
from scjax.language.analysis.partings import Parting, find_partings
from scjax.language.analysis.rings import Ring, find_ring
from scjax.language.analysis.road_sections import RoadSection, approach_turns, ego_section
from scjax.metrics.pooling import singles
from scjax.scene import AgentType, Crop, Scene

_HALF = 32.0  # m, half the edge of the window
_RING_MARGIN = 14.0  # m around a ring, whose entries are no junctions
_OF_LANES = ("crossings", "partings", "ring", "crossroads")  # parts that agents do not change
_PARKED_SPEED, _PARKED_OFFSET = 0.3, 1.4  # m/s at most, m off every lane at least


@dataclasses.dataclass(frozen=True)
class Analysis:
    """What one scene shows. Agent 0 is the ego and counts nowhere.

    Attributes:
      agents: states, as in ``Scene.agents``.
      types: ``AgentType`` of every agent.
      lines: the lanes.
      window: least and largest x, least and largest y [m].
    """

    agents: Float64[np.ndarray, "agents 9"]
    types: np.ndarray
    lines: LaneLines
    window: tuple[float, float, float, float]

    def moved(self, agents: Float64[np.ndarray, "agents 9"]) -> Analysis:
        """The analysis of the same lanes with other states of the agents; what lanes alone decide is not repeated."""
        other = dataclasses.replace(self, agents=agents)
        for name in _OF_LANES:
            other.__dict__[name] = getattr(self, name)
        return other

    @property
    def ego(self) -> Float64[np.ndarray, 9]:
        """State of agent 0; without agents, a pose at the origin."""
        return self.agents[0] if len(self.agents) else np.eye(9)[4]

    @functools.cached_property
    def speeds(self) -> Float64[np.ndarray, " agents"]:
        """[m/s]."""
        return self.agents[:, 3]

    @functools.cached_property
    def yaw(self) -> Float64[np.ndarray, " agents"]:
        """Headings [rad]."""
        return np.arctan2(self.agents[:, 5], self.agents[:, 4])

    @functools.cached_property
    def vehicles(self) -> Bool[np.ndarray, " agents"]:
        """Which agents are vehicles other than the ego."""
        return self.is_type(AgentType.VEHICLE) & (np.arange(len(self.types)) > 0)

    def is_type(self, agent_type: AgentType) -> Bool[np.ndarray, " agents"]:
        """Which agents are of a class, the ego included."""
        return self.types == agent_type

    @functools.cached_property
    def relations(self) -> AgentLanes:
        """Agents relative to all lanes."""
        return relate_to_lanes(self.lines, self.agents)

    @functools.cached_property
    def crossings(self) -> Crossings:
        """Where lanes cross, at any height."""
        return find_crossings(self.lines)

    @functools.cached_property
    def partings(self) -> list[Parting]:
        """Where lanes part and meet."""
        return find_partings(self.lines)

    @functools.cached_property
    def ring(self) -> Ring | None:
        """The ring of a roundabout."""
        return find_ring(self.lines, self.window)

    @functools.cached_property
    def crossroads(self) -> list[Crossroad]:
        """Junctions away from the ring, the nearest to the ego first."""
        found = find_crossroads(self.lines, self.crossings.at_level(), self.partings, self.window)
        ring = self.ring
        if ring is None:
            return found
        return [item for item in found if np.hypot(*(item.center - ring.center)) > ring.radius + _RING_MARGIN]

    @functools.cached_property
    def route(self) -> EgoRoute | None:
        """The ego's lane and way; None where it is on no lane."""
        return find_ego_route(self.lines, self.relations)

    @functools.cached_property
    def positions(self) -> RoutePositions | None:
        """Agents relative to the ego's way."""
        return None if self.route is None else route_positions(self.route, self.agents)

    @functools.cached_property
    def section(self) -> RoadSection | None:
        """Lanes across the ego's road."""
        return None if self.route is None else ego_section(self.lines, self.route, self.crossroads, self.ring)

    @functools.cached_property
    def turn_lanes(self) -> tuple[str, ...]:
        """Directions of the dedicated turn lanes on the ego's approach."""
        return () if self.route is None else approach_turns(self.lines, self.route, self.crossroads)

    @functools.cached_property
    def has_parking_rows(self) -> bool:
        """Whether vehicles stand in rows across aisles."""
        rows = self.vehicles
        return has_parking_rows(self.relations.distance[rows], self.relations.angle[rows], self.speeds[rows])

    @functools.cached_property
    def parked_vehicles(self) -> Bool[np.ndarray, " agents"]:
        """Which vehicles stand off every lane."""
        return self.vehicles & (self.speeds < _PARKED_SPEED) & (self.relations.offset > _PARKED_OFFSET)

    @functools.cached_property
    def layouts(self) -> tuple[str, ...]:
        """All layouts that fit, the first word for the road in front."""
        return layout_names(
            self.crossroads,
            self.partings,
            road_shape(self.route),
            has_ring=self.ring is not None,
            has_parking=self.has_parking_rows,
            has_overpass=bool(len(self.crossings.over().points)),
            is_dead_end=has_dead_end(self.lines, self.window),
        )

    def border_distance(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Distance from places inside the window to its border [m]; negative outside."""
        low, high = np.array(self.window[::2]), np.array(self.window[1::2])
        return np.minimum(places - low, high - places).min(-1)

    def junction_distance(self, places: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Distance from places to the nearest point where lanes of a junction cross or part [m]."""
        points = [item.points for item in self.crossroads]
        if self.ring is not None:
            points.append(self.ring.center[None])
        if not points:
            return np.full(len(places), np.inf)
        offset = places[:, None] - np.concatenate(points)[None]
        return np.hypot(offset[..., 0], offset[..., 1]).min(1)


def analyze(scene: Scene) -> Analysis:
    """The analysis of one scene, recorded or generated; agent 0 is the ego."""
    (scene,) = singles(scene)
    window = (0.0, 2 * _HALF, -_HALF, _HALF) if int(scene.crop) == Crop.FORWARD else (-_HALF, _HALF, -_HALF, _HALF)
    agents = np.asarray(scene.agents, np.float64)
    return Analysis(agents, np.asarray(scene.agent_types), lane_lines(scene), window)
