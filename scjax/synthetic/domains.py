"""Kinds of places: which networks they have, how much traffic, how many people; one domain drives on the left."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from scjax.synthetic.lots import parking_lot
from scjax.synthetic.motorways import motorway
from scjax.synthetic.network import Network
from scjax.synthetic.plan import TooTight, build
from scjax.synthetic.towns import TOWNS, Style
from scjax.synthetic.tracks import Tracks

_ATTEMPTS = 200
EVENTS = 0.7  # share of worlds with a rare event staged, if they have a place for it


@dataclasses.dataclass(frozen=True)
class Domain:
    """A kind of place.

    Attributes:
      share: of all worlds; mix: weights of the networks; style: of its streets.
      traffic: median vehicles for each 100 m of lane, and its spread (of the logarithm).
      crowd: chance of people, mean people for each 100 m of pavement where there are any; riders: the same of cyclists.
      left_hand: traffic keeps to the left.
    """

    name: str
    share: float
    mix: Mapping[str, float]
    style: Style
    traffic: tuple[float, float]
    crowd: tuple[float, float]
    riders: tuple[float, float]
    left_hand: bool = False

    def network(self, rng: np.random.Generator) -> tuple[str, Network]:
        """A random network and its kind."""
        kinds, weights = list(self.mix), np.array(list(self.mix.values()))
        kind = str(rng.choice(kinds, p=weights / weights.sum()))
        if kind == "motorway":
            return kind, motorway(rng)
        for _ in range(_ATTEMPTS):
            try:
                if kind == "parking lot":
                    return kind, parking_lot(self.style, rng)
                return kind, build(TOWNS[kind](self.style, rng), rng)
            except TooTight:
                continue
        raise RuntimeError(f"no {kind} of domain {self.name} could be built in {_ATTEMPTS} attempts")

    def density(self, net: Network, tracks: Tracks, rng: np.random.Generator) -> np.ndarray:
        """Vehicles a metre of every lane."""
        median, spread = self.traffic
        level = median / 100 * np.exp(spread * rng.normal())
        lanes = np.exp(0.4 * rng.normal(size=len(net.lanes)))
        wanted = np.array([0.0 if lane.centre else 1.0 for lane in net.lanes])
        slow = np.clip(12.0 / tracks.speed, 0.5, 1.6)  # the faster, the farther apart
        return np.minimum(level * lanes * wanted * slow, 0.09)

    def people(self, rng: np.random.Generator) -> tuple[float, float]:
        """People and cyclists for each 100 m, for ``bystanders.draw``."""
        return tuple(mean * rng.gamma(1.2, 1 / 1.2) if rng.random() < chance else 0.0 for chance, mean in
                     (self.crowd, self.riders))  # type: ignore[return-value]  # fmt: skip


_CITY = Style(
    limits=(20, 25, 25, 30, 35), widths=(3.0, 3.5), lanes=(0.2, 0.45, 0.28, 0.07), medians=(0.0, 0.0, 1.0, 3.2),
    one_way=0.16, parking=0.3, signals=0.65, pockets=0.5, bends=0.2,
)  # fmt: skip
_SUBURB = Style(
    limits=(30, 35, 40, 45, 50, 55), widths=(3.3, 3.75), lanes=(0.12, 0.38, 0.33, 0.17), medians=(0.0, 1.2, 3.4, 4.5),
    centre_turn=0.25, parking=0.15, walks=0.8, signals=0.6, pockets=0.8, bends=0.35,
)  # fmt: skip
_COUNTRY = Style(
    limits=(35, 45, 55), widths=(3.2, 3.6), lanes=(0.9, 0.1), medians=(0.0,), walks=0.1, signals=0.1, pockets=0.2,
    bends=0.8,
)  # fmt: skip
_TOWN = {"crossing": 0.56, "blocks": 0.14, "side streets": 0.15, "road": 0.06, "dead end": 0.03, "roundabout": 0.04,
         "parking lot": 0.03}  # fmt: skip
DOMAINS = (
    Domain("city", 0.33, _TOWN, _CITY, (0.9, 0.6), (0.45, 1.2), (0.45, 0.4)),
    Domain("suburb", 0.34, _TOWN | {"road": 0.1, "roundabout": 0.05}, _SUBURB, (0.95, 0.6), (0.3, 0.8), (0.25, 0.3)),
    Domain(
        "country", 0.07, {"road": 0.55, "crossing": 0.2, "side streets": 0.2, "roundabout": 0.05}, _COUNTRY,
        (0.8, 0.6), (0.08, 0.3), (0.1, 0.1),
    ),
    Domain("motorway", 0.14, {"motorway": 1.0}, _SUBURB, (1.6, 0.6), (0.0, 0.0), (0.0, 0.0)),
    Domain("left-hand city", 0.12, _TOWN, _CITY, (0.9, 0.6), (0.45, 1.2), (0.45, 0.4), left_hand=True),
)  # fmt: skip


def draw(rng: np.random.Generator) -> Domain:
    """A domain by its share."""
    shares = np.array([domain.share for domain in DOMAINS])
    return DOMAINS[rng.choice(len(DOMAINS), p=shares / shares.sum())]
