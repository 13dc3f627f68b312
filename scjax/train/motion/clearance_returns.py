"""The return of an agent: how much room to other bodies it keeps in the next seconds; NumPy on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

HORIZON = 15  # steps of 0.2 s
_EDGES = (0.0, 0.25, 0.5, 1.0, 1.5, 2.5, 4.0)  # m between bins
_DISCS = (-1 / 3, 0.0, 1 / 3)  # of the length, centers of the discs of a body


def return_bins(count: int) -> Float[np.ndarray, " edges"]:
    """Edges between ``count`` bins of clearance [m]."""
    places = np.linspace(0, len(_EDGES) - 1, count - 1)
    return np.interp(places, np.arange(len(_EDGES)), _EDGES)


def clearance_returns(
    x: Float[np.ndarray, "T N"],
    y: Float[np.ndarray, "T N"],
    heading: Float[np.ndarray, "T N"],
    valid: Bool[np.ndarray, "T N"],
    length: Float[np.ndarray, " N"],
    width: Float[np.ndarray, " N"],
    count: int,
) -> Int[np.ndarray, "T N"]:
    """The bin of the smallest room around each agent from each step on; 0 is contact, the last is free.

    Bodies are three discs each, as wide as the body.
    """
    steps, num = x.shape
    room = np.full((steps, num), np.inf, np.float32)
    offsets = np.array(_DISCS, np.float32)[:, None] * length
    apart = np.eye(num, dtype=bool)
    for step in range(steps):
        d_x = x[step] + offsets * np.cos(heading[step])  # [3, N]
        d_y = y[step] + offsets * np.sin(heading[step])
        e_x, e_y = d_x.reshape(-1)[:, None] - d_x.reshape(-1), d_y.reshape(-1)[:, None] - d_y.reshape(-1)
        square = (e_x * e_x + e_y * e_y).reshape(3, num, 3, num).min((0, 2))
        gap = np.sqrt(square) - 0.5 * (width[:, None] + width)
        gap[apart | ~valid[step][None] | ~valid[step][:, None]] = np.inf
        room[step] = gap.min(1)
    least = room.copy()
    for shift in range(1, HORIZON + 1):
        least[:-shift] = np.minimum(least[:-shift], room[shift:])
    return np.searchsorted(return_bins(count), least, side="right").astype(np.int32)
