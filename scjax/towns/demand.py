"""Random traffic for a SUMO network: kinds of vehicles, trips of vehicles, walks of people."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scjax.scene import AgentType
from scjax.towns.sumo_network import SumoLane, SumoNetwork

SIZES_PER_KIND = 12
_MEAN_TRIP = 110.0  # s, about; so many seconds of demand fill the streets
_FILL_TIME = 40.0  # s in which the streets are filled
_MIN_TRIP = 250.0  # m between the ends of a trip
_MAX_WALK = 300.0  # m


class _Kind(NamedTuple):
    """A kind of vehicle: share of all, size [m] and its standard deviation, acceleration [m/s²], what drives it.

    Widths are those of annotated boxes, which hold the mirrors.
    """

    share: float
    size: tuple[float, float, float]
    deviation: tuple[float, float, float]
    acceleration: float
    max_speed: float
    user: str
    agent_type: AgentType = AgentType.VEHICLE


KINDS: dict[str, _Kind] = {
    "car": _Kind(0.49, (4.65, 2.06, 1.52), (0.17, 0.06, 0.06), 2.6, 50.0, "passenger"),
    "suv": _Kind(0.18, (4.95, 2.17, 1.78), (0.13, 0.06, 0.08), 2.5, 50.0, "passenger"),
    "pickup": _Kind(0.13, (5.55, 2.32, 1.92), (0.18, 0.06, 0.08), 2.4, 50.0, "passenger"),
    "van": _Kind(0.06, (5.80, 2.40, 2.40), (0.25, 0.06, 0.20), 2.2, 45.0, "delivery"),
    "truck": _Kind(0.04, (8.20, 2.75, 3.20), (1.00, 0.10, 0.25), 1.3, 28.0, "truck"),
    "trailer": _Kind(0.02, (16.20, 2.85, 3.90), (0.50, 0.06, 0.10), 1.1, 25.0, "trailer"),
    "bus": _Kind(0.02, (11.90, 2.95, 3.10), (0.50, 0.06, 0.10), 1.2, 24.0, "bus"),
    "motorcycle": _Kind(0.03, (2.15, 0.85, 1.55), (0.12, 0.05, 0.08), 3.5, 50.0, "motorcycle"),
    "bicycle": _Kind(0.03, (1.80, 0.70, 1.75), (0.08, 0.05, 0.08), 1.1, 6.0, "bicycle", AgentType.CYCLIST),
}
PERSON_SIZE = (0.70, 0.70, 1.72)


@dataclasses.dataclass(frozen=True)
class Demand:
    """How much traffic there is.

    Attributes:
      vehicles_per_km: of lanes, once the streets are filled.
      people_per_km: of sidewalks.
      seconds: for which demand is made [s].
      seed: of all that is drawn.
      most_km: of lanes that trips begin and end on, around a random place; the rest of a larger map stays empty.
    """

    vehicles_per_km: float
    people_per_km: float
    seconds: float
    seed: int
    most_km: float = 30.0


def write_demand(network: SumoNetwork, demand: Demand, folder: Path) -> Path:
    """Writes routes.xml for a network to ``folder``."""
    rng = np.random.default_rng([demand.seed, 7])
    rows = [*_vehicle_types(rng), *_trips(network, demand, rng), *_walks(network, demand, rng)]
    order = {row: time for time, row in rows}
    path = folder / "routes.xml"
    text = "\n".join(sorted(order, key=lambda row: order[row]))
    path.write_text(f"<routes>\n{text}\n</routes>\n", encoding="utf-8")
    return path


def vehicle_sizes(seed: int) -> dict[str, tuple[float, float, float]]:
    """Length, width and height [m] of every type that ``write_demand`` writes for this seed."""
    return _sizes(np.random.default_rng([seed, 7]))


def _sizes(rng: np.random.Generator) -> dict[str, tuple[float, float, float]]:
    sizes = {}
    for name, kind in KINDS.items():
        drawn = np.clip(rng.normal(size=(SIZES_PER_KIND, 3)), -2, 2) * kind.deviation + kind.size
        sizes |= {f"{name}.{k}": tuple(np.round(row, 2).tolist()) for k, row in enumerate(drawn)}
    return sizes


def _vehicle_types(rng: np.random.Generator) -> list[tuple[float, str]]:
    rows = []
    for name, (length, width, height) in _sizes(rng).items():
        kind = KINDS[name.partition(".")[0]]
        rows.append(
            (
                -1.0,
                f'<vType id="{name}" vClass="{kind.user}" length="{length}" width="{width}" height="{height}" '
                f'accel="{kind.acceleration}" decel="3.5" emergencyDecel="8" maxSpeed="{kind.max_speed}" minGap="2.2" '
                'carFollowModel="IDM" tau="1.3" speedFactor="normc(1.0,0.12,0.7,1.3)" lcSpeedGain="0.6"/>',
            )
        )
    return rows


def _trips(network: SumoNetwork, demand: Demand, rng: np.random.Generator) -> list[tuple[float, str]]:
    lanes = [lane for lane in network.lanes.values() if lane.has_cars and not lane.is_internal and lane.length > 25.0]
    lanes = _part_of_town(lanes, demand)
    if not lanes:
        return []
    lengths, places = _lengths(lanes), _middles(lanes)
    number = demand.vehicles_per_km * lengths.sum() / 1000
    later = int(number * max(demand.seconds - _FILL_TIME, 0.0) / _MEAN_TRIP)
    times = np.concatenate([rng.uniform(0, _FILL_TIME, int(number)), rng.uniform(_FILL_TIME, demand.seconds, later)])
    names, shares = list(KINDS), np.array([kind.share for kind in KINDS.values()])
    kinds = rng.choice(len(names), len(times), p=shares / shares.sum())
    starts = rng.choice(len(lanes), len(times), p=lengths / lengths.sum())
    rows = []
    for k, (time, kind, start) in enumerate(zip(times, kinds, starts, strict=True)):
        goals = rng.choice(len(lanes), 8, p=lengths / lengths.sum())
        far = goals[np.hypot(*(places[goals] - places[start]).T) > _MIN_TRIP]
        goal = far[0] if len(far) else goals[0]
        name = f"{names[kind]}.{rng.integers(SIZES_PER_KIND)}"
        position, speed = ("random_free", "avg") if time < _FILL_TIME else ("base", "max")
        rows.append(
            (
                float(time),
                f'<trip id="v{k}" type="{name}" depart="{time:.1f}" from="{lanes[start].edge}" to="{lanes[goal].edge}" '
                f'departLane="best" departPos="{position}" departSpeed="{speed}"/>',
            )
        )
    return rows


def _walks(network: SumoNetwork, demand: Demand, rng: np.random.Generator) -> list[tuple[float, str]]:
    walks = [lane for lane in network.lanes.values() if lane.has_people and lane.length > 10.0]
    walks = _part_of_town(walks, demand)
    if not walks:
        return []
    lengths, places = _lengths(walks), _middles(walks)
    number = demand.people_per_km * lengths.sum() / 1000
    times = np.concatenate(
        [rng.uniform(0, 20.0, int(number)), rng.uniform(0, demand.seconds, int(number * demand.seconds / 200.0))]
    )
    rows = []
    for k, time in enumerate(times):
        start = rng.choice(len(walks), p=lengths / lengths.sum())
        near = np.flatnonzero(np.hypot(*(places - places[start]).T) < _MAX_WALK)
        goal = rng.choice(near)
        rows.append(
            (
                float(time),
                f'<person id="p{k}" depart="{time:.1f}" departPos="random"><walk from="{walks[start].edge}" '
                f'to="{walks[goal].edge}" arrivalPos="{rng.uniform(0, walks[goal].length):.1f}"/></person>',
            )
        )
    return rows


def _part_of_town(lanes: list[SumoLane], demand: Demand) -> list[SumoLane]:
    """The lanes nearest to a random place, ``most_km`` of them at most; the same place for cars and people."""
    if sum(lane.length for lane in lanes) <= 1000 * demand.most_km:
        return lanes
    middles = _middles(lanes)
    share = np.random.default_rng([demand.seed, 13]).random(2)
    place = np.quantile(middles[:, 0], share[0]), np.quantile(middles[:, 1], share[1])
    order = np.argsort(np.hypot(*(middles - place).T))
    lengths = np.cumsum([lanes[row].length for row in order])
    return [lanes[row] for row in order[lengths <= 1000 * demand.most_km]]


def _lengths(lanes: list[SumoLane]) -> np.ndarray:
    return np.array([lane.length for lane in lanes])


def _middles(lanes: list[SumoLane]) -> np.ndarray:
    """A place near the middle of every lane [lanes, 2]."""
    return np.stack([lane.points[len(lane.points) // 2] for lane in lanes])
