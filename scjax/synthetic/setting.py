"""What a world begins with: a map, its ground, and a stage with traffic before anything has moved."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from scjax.language.analysis.rare_events import EVENTS
from scjax.synthetic import actors, domains
from scjax.synthetic.bystanders import draw_bystanders
from scjax.synthetic.events import draw_event
from scjax.synthetic.ground import Ground
from scjax.synthetic.lane_arrays import LaneArrays, build_lane_arrays
from scjax.synthetic.network import Network
from scjax.synthetic.network_types import draw_network
from scjax.synthetic.signals import SignalTiming
from scjax.synthetic.stage import Stage, moment_times
from scjax.synthetic.traffic import TrafficSimulation, draw_fleet

VERSION = 8  # raise it with every change of what a seed gives
_EVENT_WEIGHTS = {  # the others have 1; few places allow double parking, many scenes see one corridor
    "double-parking": 3.0,
    "cut-in": 2.0,
    "wrong-way": 1.1,
    "work-zone": 1.5,
    "emergency-corridor": 1.0,
}
_SIGNALS_RECORDED_SHARE = 0.9  # of the worlds with signals
_FREIGHT_SHARE, _FREIGHT_FACTOR = 0.09, 9.0  # of worlds with many trucks and buses; times as many


@dataclasses.dataclass(frozen=True)
class Setting:
    """The beginning of a world, in right-hand traffic.

    Attributes:
      name: "<domain>-<seed>-<number>".
      domain, network_type: of the map.
      net, lanes: the road network, and its lanes as arrays.
      ground: the terrain.
      stage: traffic, bystanders and the rare event.
      records_signals: whether signals are recorded.
      rng: for all that happens on the stage.
    """

    name: str
    domain: domains.Domain
    network_type: str
    net: Network
    lanes: LaneArrays
    ground: Ground
    stage: Stage
    records_signals: bool
    rng: np.random.Generator

    def recorded_signals(self) -> Int[np.ndarray, " lanes"]:
        """``Signal`` of every lane now, as far as signals are recorded."""
        signals = self.stage.simulation.signals
        return signals.copy() if self.records_signals else np.zeros_like(signals)


def draw_setting(seed: int, k: int, events: Sequence[str] = (), event_share: float = domains.EVENT_SHARE) -> Setting:
    """The beginning of world ``k`` of ``seed``.

    Args:
      events: names of events; the world shows one of them if it has a place for it. Empty: any event or none.
      event_share: probability of an event if ``events`` is empty.

    Raises:
      ValueError: if one of the numbers is negative.
    """
    if seed < 0 or k < 0:
        raise ValueError(f"seed is {seed} and k is {k}: worlds are counted from 0")
    rng = np.random.default_rng([VERSION, seed, k])
    domain = domains.draw_domain(rng)
    network_type = domain.draw_network_type(rng)
    net = draw_network(network_type, domain.style, rng)
    lanes = build_lane_arrays(net)
    timings = [SignalTiming.draw(junction, moment_times(), rng) for junction in net.junctions if junction.phases]
    records_signals = bool(timings) and rng.random() < _SIGNALS_RECORDED_SHARE
    event = None
    if rng.random() < (1.0 if events else event_share):
        choices = events or tuple(EVENTS)
        weights = np.array([1.0 if events else _EVENT_WEIGHTS.get(name, 1.0) for name in choices])
        event = draw_event(str(rng.choice(choices, p=weights / weights.sum())), net, lanes, rng)
    densities = domain.draw_densities(net, lanes, rng)
    long_factor = _FREIGHT_FACTOR if rng.random() < _FREIGHT_SHARE else 1.0
    fleet = draw_fleet(
        lanes, densities, lambda count: actors.draw_vehicle_sizes(count, rng, long_factor=long_factor), rng
    )
    if event is not None:
        fleet = event.prepare_traffic(fleet, rng)
    simulation = TrafficSimulation(lanes, timings, fleet, rng)
    pedestrian_density, cyclist_density = domain.pedestrians.draw(rng), domain.cyclists.draw(rng)
    bystanders = draw_bystanders(net, lanes, pedestrian_density, cyclist_density, rng)
    return Setting(
        name=f"{domain.name}-{seed}-{k:06d}",
        domain=domain,
        network_type=network_type,
        net=net,
        lanes=lanes,
        ground=Ground.draw(rng),
        stage=Stage(net, simulation, bystanders, event),
        records_signals=records_signals,
        rng=rng,
    )
