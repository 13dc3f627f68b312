"""Who crosses the stop point of a signal while it shows STOP."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from scjax.metrics.object_boxes import ObjectBoxes
from scjax.scene import Log, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.scene.stop_points import stop_points

_HALF_WIDTH, _MAX_ANGLE = 1.75, np.deg2rad(45.0)  # of a stop line [m]; between its lane and a vehicle that crosses it
_TOGETHER = 1.75  # m; stop points of one place


def red_light_crossings(
    log: Log, boxes: ObjectBoxes, reach: Float64[np.ndarray, " N"] | None = None
) -> Bool[np.ndarray, "N T"]:
    """Whether each object crosses a stop point between the step before and this one while its signal is STOP.

    The line is at the recorded stop point, or at the start of the lane, across the lane. It is 3.5 m wide, and is
    crossed in the direction of the lane within 45 degrees, by an object that is valid at both steps. The state counts
    that the signal has at the step before. Where lanes part, several signals have one place: to cross it is a violation
    only if all of them are STOP.

    Args:
      log: signals and lanes.
      boxes: its objects.
      reach: from the center of each object to what must cross [m]: the front (half the length), or None for the center.
    """
    crossed = np.zeros(boxes.valid.shape, bool)
    points = stop_points(log)
    if not len(points.signals) or not len(crossed):
        return crossed
    states = log.signal_states[points.signals] == Signal.STOP
    stops = (states[None] | ~points.groups(_TOGETHER)[..., None]).all(1)  # all signals of the place [points, T]
    fronts = boxes.positions
    if reach is not None:
        fronts = fronts + reach[:, None, None] * np.stack([np.cos(boxes.headings), np.sin(boxes.headings)], -1)
    directions = np.arctan2(points.directions[:, 1], points.directions[:, 0])
    both = boxes.valid[:, 1:] & boxes.valid[:, :-1]
    for k in np.flatnonzero(stops.any(-1)).tolist():
        ahead = points.directions[k]
        offset = fronts - points.positions[k]
        way = offset @ ahead
        row, step = np.nonzero((way[:, :-1] < 0) & (way[:, 1:] >= 0) & both & stops[k, :-1])
        side = np.abs(offset[row, step + 1] @ np.array([-ahead[1], ahead[0]]))
        turn = np.abs(wrap_to_pi(boxes.headings[row, step + 1] - directions[k]))
        fits = (side < _HALF_WIDTH) & (turn < _MAX_ANGLE)
        crossed[row[fits], step[fits] + 1] = True
    return crossed
