"""Roundabouts: a counter-clockwise ring with one entry and one exit per arm."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import TURN_SPACING, cubic_curve
from scjax.synthetic.network import Junction, Lane, Network

RING_CLEARANCE = 9.0  # m from the ring to the end of the arms
_EXIT_DISTANCE = 6.5  # m along the ring, from the axis of an arm to its exit and to its entry
_SPEED = 7.0  # m/s
_ENTRY_RANK = 3  # the ring has the right of way


def add_ring(net: Network, junction: Junction, radius: float) -> None:
    """Connects the arms of ``junction`` by a ring with ``radius`` [m]."""
    number = net.junctions.index(junction)
    exit_angle = _EXIT_DISTANCE / radius
    # The exit, then the entry of every arm, counter-clockwise.
    angles = [arm.angle + sign * exit_angle for arm in junction.arms for sign in (-1, 1)]
    ring = []
    for k, start in enumerate(angles):
        end = start + (angles[(k + 1) % len(angles)] - start) % (2 * np.pi)
        angle = np.linspace(start, end, max(4, round((end - start) * radius / TURN_SPACING)))
        points = junction.center + radius * np.stack([np.cos(angle), np.sin(angle)], -1)
        # Entries conflict with the parts between the exit and the entry of an arm.
        ring.append(net.add_lane(Lane(points, _SPEED, junction=number if k % 2 == 0 else -1)))
        junction.connectors.append(ring[-1])
    for k, lane in enumerate(ring):
        net.link(lane, ring[(k + 1) % len(ring)])
    for a, arm in enumerate(junction.arms):
        before_exit, after_entry = ring[2 * a - 1], ring[2 * a + 1]
        for lane, _ in arm.inbound[:1]:
            points = _connect(net.lanes[lane].points, net.lanes[after_entry].points)
            connector = net.add_lane(
                Lane(
                    points,
                    _SPEED,
                    successors=[after_entry],
                    junction=number,
                    arm=a,
                    entry_lane=lane,
                    rank=_ENTRY_RANK,
                )
            )
            net.link(lane, connector)
            junction.connectors.append(connector)
        for lane in arm.outbound[:1]:
            points = _connect(net.lanes[before_exit].points, net.lanes[lane].points)
            connector = net.add_lane(Lane(points, _SPEED, successors=[lane], arm=a))
            net.link(before_exit, connector)
            junction.connectors.append(connector)


def _connect(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    start, end = before[-1] - before[-2], after[1] - after[0]
    start_heading, end_heading = float(np.arctan2(*start[::-1])), float(np.arctan2(*end[::-1]))
    return cubic_curve(before[-1], start_heading, after[0], end_heading, TURN_SPACING)
