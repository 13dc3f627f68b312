"""Angles in numpy."""

from __future__ import annotations

import numpy as np


def wrap_to_pi(angle):
    """Angle in the range -pi .. pi [rad]; numpy counterpart of ``scjax.scene.geometry.wrap_angle``."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
