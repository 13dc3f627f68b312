"""Domains: kinds of places, with their networks, traffic and pedestrians. In one domain traffic keeps left.

To add a domain, add a line to ``DOMAINS``; shares are relative, so existing ones keep their ratio. Every change of
``DOMAINS`` changes the worlds of all seeds: raise ``scjax.synthetic.setting.VERSION``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network
from scjax.synthetic.streets import StreetStyle

EVENT_SHARE = 0.6  # of worlds with a rare event, if they have a place for it
_MAX_DENSITY = 0.1  # vehicles per meter
_JAM_SHARE, _JAM_FACTOR = 0.05, 3.0  # of worlds with much more traffic; of the density there
_LANE_SPREAD = 0.4  # standard deviation of the logarithm of the density among the lanes of a world


@dataclasses.dataclass(frozen=True)
class TrafficDensity:
    """Log-normal distribution of vehicles per 100 m of lane: median and standard deviation of the logarithm."""

    median: float
    spread: float


@dataclasses.dataclass(frozen=True)
class BystanderDensity:
    """Probability that a world has pedestrians (cyclists) at all, and their mean number per 100 m if it has."""

    probability: float
    mean: float

    def draw(self, rng: np.random.Generator) -> float:
        """Number per 100 m of sidewalk or lane."""
        return self.mean * rng.gamma(1.2, 1 / 1.2) if rng.random() < self.probability else 0.0


@dataclasses.dataclass(frozen=True)
class Domain:
    """A kind of place.

    Attributes:
      name: of the domain.
      share: of all worlds.
      networks: weights of network types (``NETWORK_BUILDERS``).
      style: of the streets.
      traffic: density of vehicles.
      pedestrians, cyclists: their densities.
      left_hand: whether traffic keeps left.
    """

    name: str
    share: float
    networks: Mapping[str, float]
    style: StreetStyle
    traffic: TrafficDensity
    pedestrians: BystanderDensity
    cyclists: BystanderDensity
    left_hand: bool = False

    def draw_network_type(self, rng: np.random.Generator) -> str:
        """A network type by its weight."""
        types, weights = list(self.networks), np.array(list(self.networks.values()))
        return str(rng.choice(types, p=weights / weights.sum()))

    def draw_densities(self, net: Network, lanes: LaneArrays, rng: np.random.Generator) -> np.ndarray:
        """Vehicles per meter of every lane [lanes]."""
        density = self.traffic.median / 100 * np.exp(self.traffic.spread * rng.normal())
        density *= _JAM_FACTOR if rng.random() < _JAM_SHARE else 1.0
        variation = np.exp(_LANE_SPREAD * rng.normal(size=len(net.lanes)))
        headway_factor = np.clip(12.0 / lanes.speed, 0.5, 1.6)  # fast traffic keeps larger distances
        return np.minimum(density * variation * headway_factor, _MAX_DENSITY)


_CITY = StreetStyle(
    limits=(25, 30, 30, 35, 40, 45),
    widths=(3.0, 3.5),
    lanes=(0.29, 0.19, 0.25, 0.2, 0.07),
    medians=(0.0, 1.0, 3.2, 3.2),
    one_way=0.16,
    parking=0.14,
    signals=0.5,
    pockets=0.8,
    bends=0.2,
)
_SUBURB = StreetStyle(
    limits=(30, 35, 40, 45, 50, 55),
    widths=(3.3, 3.75),
    lanes=(0.24, 0.17, 0.27, 0.23, 0.09),
    medians=(0.0, 1.2, 3.4, 3.6, 4.5),
    parking=0.08,
    sidewalks=0.8,
    signals=0.5,
    pockets=0.9,
    bends=0.35,
)
_COUNTRY = StreetStyle(
    limits=(35, 45, 55),
    widths=(3.2, 3.6),
    lanes=(0.9, 0.1),
    medians=(0.0,),
    sidewalks=0.1,
    signals=0.1,
    pockets=0.2,
    bends=0.8,
)
_TOWN_NETWORKS = {
    "crossing": 0.57,
    "blocks": 0.17,
    "side streets": 0.1,
    "Y": 0.1,
    "road": 0.14,
    "dead end": 0.03,
    "winding road": 0.085,
    "roundabout": 0.055,
    "parking lot": 0.085,
}
_CITY_TRAFFIC = TrafficDensity(0.8, 0.7)
_CITY_PEDESTRIANS, _CITY_CYCLISTS = BystanderDensity(0.6, 1.2), BystanderDensity(0.45, 0.4)
DOMAINS = (
    Domain("city", 0.33, _TOWN_NETWORKS, _CITY, _CITY_TRAFFIC, _CITY_PEDESTRIANS, _CITY_CYCLISTS),
    Domain(
        name="suburb",
        share=0.34,
        networks=_TOWN_NETWORKS | {"road": 0.17, "roundabout": 0.06},
        style=_SUBURB,
        traffic=TrafficDensity(0.85, 0.7),
        pedestrians=BystanderDensity(0.45, 0.9),
        cyclists=BystanderDensity(0.25, 0.3),
    ),
    Domain(
        name="country",
        share=0.07,
        networks={"road": 0.4, "winding road": 0.2, "crossing": 0.2, "side streets": 0.15, "roundabout": 0.05},
        style=_COUNTRY,
        traffic=TrafficDensity(0.8, 0.6),
        pedestrians=BystanderDensity(0.08, 0.3),
        cyclists=BystanderDensity(0.1, 0.1),
    ),
    Domain(
        name="motorway",
        share=0.16,
        networks={"motorway": 1.0},
        style=_SUBURB,
        traffic=TrafficDensity(1.6, 0.6),
        pedestrians=BystanderDensity(0.0, 0.0),
        cyclists=BystanderDensity(0.0, 0.0),
    ),
    Domain(
        name="left-hand city",
        share=0.12,
        networks=_TOWN_NETWORKS,
        style=_CITY,
        traffic=_CITY_TRAFFIC,
        pedestrians=_CITY_PEDESTRIANS,
        cyclists=_CITY_CYCLISTS,
        left_hand=True,
    ),
)


def draw_domain(rng: np.random.Generator) -> Domain:
    """A domain by its share."""
    shares = np.array([domain.share for domain in DOMAINS])
    return DOMAINS[rng.choice(len(DOMAINS), p=shares / shares.sum())]
