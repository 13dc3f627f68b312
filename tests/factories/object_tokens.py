"""Tokens of the package's vision network that say which objects a picture shows."""

from __future__ import annotations

import numpy as np

from scjax.encoders.dashcam_network import FINE, PLACE_SCALE, DashcamConfig

CELL = (DashcamConfig().width - DashcamConfig().features) // FINE**2  # numbers of a fine cell
VEHICLE, PEDESTRIAN = 5, 6  # semantic classes


def tokens(*objects, cells=9):
    """Tokens of which the first fine cells show objects (semantic class, x, y, heading, length, width)."""
    fine = np.zeros((cells * FINE**2, CELL), np.float32)
    fine[:, 20] = -8.0  # no object
    for cell, (kind, x, y, heading, length, width) in enumerate(objects):
        fine[cell, kind] = 10.0
        numbers = (x / PLACE_SCALE, y / PLACE_SCALE, np.cos(heading), np.sin(heading), length / 10, width / 10, 6.0)
        fine[cell, 14:21] = numbers
    return np.concatenate([np.ones((cells, 5)), fine.reshape(cells, -1)], 1).astype(np.float32)


CAR = (VEHICLE, 12.0, 3.0, 0.5, 4.5, 1.8)
