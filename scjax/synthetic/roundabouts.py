"""Roundabouts: a ring driven counter-clockwise, with one entry and one exit an arm."""

from __future__ import annotations

import numpy as np

from scjax.synthetic.curves import FINE, spline
from scjax.synthetic.network import Junction, Lane, Network

_SPREAD = 6.5  # metres along the ring from an arm's axis to its exit and to its entry
_SPEED = 7.0  # m/s
_YIELDS = 3  # rank of entries; those on the ring go first


def add_ring(net: Network, junction: Junction, radius: float) -> None:
    """Joins the arms of ``junction`` by a ring of ``radius`` metres; arms end some metres outside of it."""
    number = net.junctions.index(junction)
    spread = _SPREAD / radius
    # Exit, then entry of every arm, counter-clockwise.
    nodes = [arm.angle + sign * spread for arm in junction.arms for sign in (-1, 1)]
    pieces = []
    for k, start in enumerate(nodes):
        end = start + (nodes[(k + 1) % len(nodes)] - start) % (2 * np.pi)
        at = np.linspace(start, end, max(4, round((end - start) * radius / FINE)))
        points = junction.centre + radius * np.stack([np.cos(at), np.sin(at)], -1)
        # From an exit to the entry beside it the ring has the right of way.
        pieces.append(net.add(Lane(points, _SPEED, junction=number if k % 2 == 0 else -1)))
        junction.connectors.append(pieces[-1])
    for k, piece in enumerate(pieces):
        net.join(piece, pieces[(k + 1) % len(pieces)])
    for a, arm in enumerate(junction.arms):
        leaving, entering = pieces[2 * a - 1], pieces[2 * a + 1]
        for lane, _ in arm.inbound[:1]:
            points = _link(net.lanes[lane].points, net.lanes[entering].points)
            made = net.add(
                Lane(points, _SPEED, successors=[entering], junction=number, arm=a, entry=lane, rank=_YIELDS)
            )
            net.join(lane, made)
            junction.connectors.append(made)
        for lane in arm.outbound[:1]:
            points = _link(net.lanes[leaving].points, net.lanes[lane].points)
            made = net.add(Lane(points, _SPEED, successors=[lane], arm=a))
            net.join(leaving, made)
            junction.connectors.append(made)


def _link(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    out, into = before[-1] - before[-2], after[1] - after[0]
    return spline(before[-1], float(np.arctan2(*out[::-1])), after[0], float(np.arctan2(*into[::-1])), FINE)
