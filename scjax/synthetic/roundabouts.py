"""Roundabouts: counter-clockwise rings, with an entry and an exit of every ring per arm."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import TURN_SPACING, turn_curve
from scjax.synthetic.network import Junction, Lane, Network

RING_CLEARANCE = 11.0  # m from the outer ring to the end of the arms
_RING_SPACING = 4.2  # m between two rings
_EXIT_DISTANCE = 8.0  # m along the ring, from the axis of an arm to its exit and to its entry
_EXIT_DISTANCE_PER_RING = 3.5  # m more for every ring further out, whose lanes of the arms lie further out too
_SPEED = 7.0  # m/s
_ENTRY_RANK = 3  # the ring has the right of way


def outer_ring_radius(radius: float, lanes: int) -> float:
    """Radius of the outermost of ``lanes`` rings around a ring of ``radius`` [m]."""
    return radius + (lanes - 1) * _RING_SPACING


def add_roundabout(net: Network, junction: Junction, radius: float, lanes: int) -> None:
    """Connects the arms of ``junction`` by rings; lane k of an arm, from the inside, leads to ring k and back.

    Args:
      radius: of the innermost ring [m].
      lanes: number of rings.
    """
    number = net.junctions.index(junction)
    for k in range(lanes):
        _add_ring(net, junction, number, k, outer_ring_radius(radius, k + 1), is_outermost=k == lanes - 1)


def _add_ring(net: Network, junction: Junction, number: int, position: int, radius: float, is_outermost: bool) -> None:
    """Adds the ring at ``position`` from the inside, with its entries and exits."""
    exit_angle = (_EXIT_DISTANCE + position * _EXIT_DISTANCE_PER_RING) / radius
    # The exit, then the entry of every arm, counter-clockwise.
    angles = [arm.angle + sign * exit_angle for arm in junction.arms for sign in (-1, 1)]
    ring = []
    for k, start in enumerate(angles):
        end = start + (angles[(k + 1) % len(angles)] - start) % (2 * np.pi)
        angle = np.linspace(start, end, max(4, round((end - start) * radius / TURN_SPACING)))
        points = junction.center + radius * np.stack([np.cos(angle), np.sin(angle)], -1)
        # Entries, and exits from inner rings, conflict with the parts between the exit and the entry of an arm.
        ring.append(net.add_lane(Lane(points, _SPEED, junction=number if k % 2 == 0 else -1)))
        junction.connectors.append(ring[-1])
    for k, lane in enumerate(ring):
        net.link(lane, ring[(k + 1) % len(ring)])
    for a, arm in enumerate(junction.arms):
        before_exit, after_entry = ring[2 * a - 1], ring[2 * a + 1]
        for lane, _ in arm.inbound[position : position + 1]:
            points = turn_curve(net.lanes[lane].points, net.lanes[after_entry].points)
            connector = Lane(points, _SPEED, successors=[after_entry], junction=number, arm=a, entry_lane=lane)
            connector.rank = _ENTRY_RANK
            net.link(lane, net.add_lane(connector))
            junction.connectors.append(net.lanes[lane].successors[-1])
        for lane in arm.outbound[position : position + 1]:
            points = turn_curve(net.lanes[before_exit].points, net.lanes[lane].points)
            connector = Lane(points, _SPEED, successors=[lane], arm=a, junction=-1 if is_outermost else number)
            net.link(before_exit, net.add_lane(connector))
            junction.connectors.append(net.lanes[before_exit].successors[-1])
