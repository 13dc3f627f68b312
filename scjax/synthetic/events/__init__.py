"""Rare events in synthetic worlds: one file per event.

To add an event that ``scjax.language.analysis.rare_events`` knows, write a file with a ``StagedEvent`` subclass and add
the class to ``EVENT_CLASSES``.
"""

from __future__ import annotations

import numpy as np

from scjax.synthetic.events.base import StagedEvent
from scjax.synthetic.events.blocked_lane import DoubleParking, StoppedVehicle
from scjax.synthetic.events.cut_in import CutIn
from scjax.synthetic.events.emergency_corridor import EmergencyCorridor
from scjax.synthetic.events.jaywalker import Jaywalker
from scjax.synthetic.events.work_zone import WorkZone
from scjax.synthetic.events.wrong_way_driver import WrongWayDriver
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network

__all__ = ["EVENT_CLASSES", "StagedEvent", "draw_event"]

EVENT_CLASSES: dict[str, type[StagedEvent]] = {
    cls.event: cls
    for cls in (WrongWayDriver, Jaywalker, StoppedVehicle, DoubleParking, EmergencyCorridor, CutIn, WorkZone)
}


def draw_event(event: str, net: Network, lanes: LaneArrays, rng: np.random.Generator) -> StagedEvent | None:
    """A random place for an event; None where the network has none."""
    return EVENT_CLASSES[event].draw(net, lanes, rng)
