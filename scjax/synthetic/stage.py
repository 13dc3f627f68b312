"""A world in motion: traffic, bystanders and a rare event, step by step."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.bystanders import Bystanders
from scjax.synthetic.events import StagedEvent
from scjax.synthetic.events.base import LEAD_TIME
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import TIME_STEP, TrafficSimulation
from scjax.synthetic.traffic.fleet import vehicle_ids

NUM_MOMENTS = 3  # of a world
_MOMENT_INTERVAL = 12.0  # s
_WARM_UP_TIME = 18.0  # s of traffic before the first moment


@dataclasses.dataclass
class Stage:
    """All that moves in a world."""

    net: Network
    simulation: TrafficSimulation
    bystanders: Bystanders
    event: StagedEvent | None

    def run(self, seconds: float) -> None:
        """Lets ``seconds`` pass, in steps of ``TIME_STEP``."""
        for _ in range(round(seconds / TIME_STEP)):
            if self.event is not None:
                self.event.step(self.simulation)
                self.simulation.obstacles = self.event.obstacles()
            self.bystanders.step(TIME_STEP, self.simulation.right_of_way)
            self.simulation.step()

    def agents(self) -> Actors:
        """All agents now; some may overlap. Those of the event come first, then vehicles in traffic."""
        standing = self.bystanders.at(self.simulation.lanes, self.simulation.time)
        staged = actors.no_actors() if self.event is None else self.event.actors()
        return actors.concatenate_actors([staged, self._traffic_agents(), standing])

    def _traffic_agents(self) -> Actors:
        """The vehicles of the simulation that are on the map."""
        fleet, lanes = self.simulation.fleet, self.simulation.lanes
        rows = np.flatnonzero(fleet.lane >= 0)
        lane = fleet.lane[rows]
        positions, headings = fleet.poses(lanes, rows)
        level = np.array([one.height for one in self.net.lanes])[lane]
        made = actors.make_actors(
            AgentType.VEHICLE, positions, headings, fleet.speed[rows], fleet.sizes[rows], level, lane
        )
        made.ids = vehicle_ids(fleet, rows)
        return made


def moment_times(count: int = NUM_MOMENTS) -> Float64[np.ndarray, " count"]:
    """Times of the first ``count`` moments of a world [s]."""
    return _WARM_UP_TIME + _MOMENT_INTERVAL * np.arange(count)


def play(stage: Stage, rng: np.random.Generator, ahead: float = 0.0) -> Iterator[tuple[int, float]]:
    """Runs a stage through all moments, and ``ahead`` [s] after the last.

    Yields:
      After every step the number of the moment, and the time from it, negative before it [s]. Each moment has the
      steps from ``LEAD_TIME`` before it until those of the next one.
    """
    step = -round(_WARM_UP_TIME / TIME_STEP)
    lead, interval = round(LEAD_TIME / TIME_STEP), round(_MOMENT_INTERVAL / TIME_STEP)
    for moment in range(NUM_MOMENTS):
        last = interval - lead if moment + 1 < NUM_MOMENTS else round(ahead / TIME_STEP)
        while step < last:
            if step == -lead and stage.event is not None:
                stage.event.start(stage.simulation, rng)
            stage.run(TIME_STEP)
            step += 1
            yield moment, step * TIME_STEP
        step = -lead


def without_overlaps(agents: Actors) -> Actors:
    """The agents without the later one of each two that overlap."""
    pairs = actors.overlapping_actors(agents)
    return agents if not len(pairs) else agents.select(np.setdiff1d(np.arange(len(agents)), pairs[:, 1]))
