"""Bounds of what a scene or log may hold; larger values are damage, and larger files would fill the memory."""

from __future__ import annotations

MAX_COORDINATE = 1e7  # m from the origin, a quarter of the way round the earth
MAX_SIZE = 100.0  # m, edge of a box
MAX_SPEED = 1000.0  # m/s
MAX_SLOTS = 4096  # agents or lanes of a scene in a file; a tile has MAX_AGENTS and MAX_LANES
