"""All that stands on the ground of a log at a step: objects as their shapes, signals, buildings and trees."""

from __future__ import annotations

import copy
import zlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.camera.agent_boxes import box_corners_3d
from scjax.camera.dashcam.materials import AGENT_CLASSES, COLORS, PAINT_SHARES, PAINTS, Material, SemanticClass
from scjax.camera.dashcam.shapes import SHAPES, shape_of
from scjax.camera.dashcam.solids import REAR, Solids, join_solids, place_parts
from scjax.camera.dashcam.surroundings import hashed_numbers, surrounding_solids
from scjax.camera.signal_places import HEAD_HEIGHT, HEAD_SIZE, signal_places
from scjax.camera.source_log import SNAP_DISTANCE, LogGround, known_sizes
from scjax.scene import NO_EGO, AgentType, Log, Signal

DETAIL = 25.0  # m; objects farther away are drawn with their coarse parts only
REACH = 130.0  # m
_SHADOWS = 60.0  # m; shadows farther away are not drawn
_LAMPS = {
    Signal.GO: (Material.LAMP_GO, -0.33),
    Signal.CAUTION: (Material.LAMP_CAUTION, 0.0),
    Signal.STOP: (Material.LAMP_STOP, 0.33),
}
"""Material and height of the lamp that shines, from the middle of the head [m]."""


class WorldSolids:
    """Solids of a log; z is above the ground, which is level.

    Args:
      log: that is shown.
      ground: of the log.
      seed: of colors, buildings and trees.
      left_out: index of the object that is not shown.
    """

    def __init__(self, log: Log, ground: LogGround, seed: int, left_out: int = NO_EGO):
        self._log, self._ground, self._left_out = log, ground, left_out
        self._sizes = known_sizes(log)
        types = np.asarray(log.object_types)
        self._shapes = shape_of(types, self._sizes)
        self._classes = np.array(
            [AGENT_CLASSES[AgentType(k)] if k >= 0 else SemanticClass.OTHER for k in types.tolist()]
        )
        self._paints = object_colors(log.object_ids, seed)
        self._signals = signal_places(log)
        self._static = surrounding_solids(log, seed)
        self._static_middles = self._static.corners[:, :, :2].mean(1)

    def without(self, left_out: int, ground: LogGround) -> WorldSolids:
        """The same solids for another carrier, which is not shown, and its ground."""
        other = copy.copy(self)
        other._left_out, other._ground = left_out, ground
        return other

    def feet(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the objects that are shown at a step, and the middle of their bottoms [n, 3]: z above the ground."""
        log = self._log
        valid = log.valid[:, step].copy()
        if self._left_out != NO_EGO:
            valid[self._left_out] = False
        rows = np.flatnonzero(valid)
        places = log.positions[rows, step].copy()
        if len(rows):
            places[:, 2] -= self._sizes[rows, 2] / 2 + self._ground.heights(places[:, :2], step)
        # Boxes that float or sink a little stand on the ground; those on bridges and ramps stay above it.
        stands = ~(np.abs(places[:, 2]) >= SNAP_DISTANCE) | (places[:, 2] < 0)
        places[stands, 2] = 0.0
        return rows, places

    def at(self, step: int, position: Float64[np.ndarray, " 3"], ahead: Float64[np.ndarray, " 2"]) -> Solids:
        """Solids within reach of a camera at ``position`` that looks to ``ahead``."""
        rows, places = self.feet(step)
        offset = places[:, :2] - position[:2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        seen = (distance < REACH) & (offset @ ahead > -self._sizes[rows].max(1, initial=0.0))
        rows, places, distance = rows[seen], places[seen], distance[seen]
        groups = [self._near_static(position, ahead), self._heads(step, position)]
        for shape, parts in SHAPES.items():
            for coarse in (False, True):
                chosen = (self._shapes[rows] == shape) & ((distance > DETAIL) == coarse)
                count = parts.coarse if coarse else len(parts.corners)
                if chosen.any():
                    groups.append(
                        self._objects(rows[chosen], places[chosen], step, parts.corners[:count], parts.materials)
                    )
        return join_solids(groups)

    def _objects(
        self, rows: np.ndarray, places: np.ndarray, step: int, corners: np.ndarray, materials: np.ndarray
    ) -> Solids:
        count, parts = len(rows), len(corners)
        placed = place_parts(corners, places, self._log.headings[rows, step], self._sizes[rows])
        own = np.tile(materials[:parts], (count, 1))
        colors = COLORS[own]
        for column, material in enumerate((Material.PAINT, Material.CLOTH, Material.TROUSERS)):
            paint = np.repeat(self._paints[rows, column], parts, 0)[:, None]
            colors = np.where((own == material)[..., None], paint, colors)
        ids = np.repeat(rows, parts)
        return Solids(placed.reshape(-1, 8, 3), colors, own, self._classes[ids], ids)

    def _near_static(self, position: np.ndarray, ahead: np.ndarray) -> Solids:
        offset = self._static_middles - position[:2]
        near = (np.abs(offset).max(-1, initial=0.0) < REACH) & (offset @ ahead > -12.0)
        return Solids(*(field[near] for field in self._static))

    def _heads(self, step: int, position: np.ndarray) -> Solids:
        """Heads of signals whose state is known, each with the lamp that shines towards the traffic."""
        places = self._signals
        states = np.asarray(self._log.signal_states)[places.rows, step]
        near = np.abs(places.heads[:, :2] - position[:2]).max(-1, initial=0.0) < REACH
        rows = np.flatnonzero((states != Signal.UNKNOWN) & near)
        centers = places.heads[rows].copy()
        centers[:, 2] = HEAD_HEIGHT
        headings, count = places.headings[rows], len(rows)
        boxes = box_corners_3d(centers, headings, np.tile(HEAD_SIZE, (count, 1)))
        lamps = [_LAMPS[Signal(int(state))] for state in states[rows]]
        ahead = np.stack([np.cos(headings), np.sin(headings)], -1)
        lit = centers.copy()
        lit[:, :2] -= (HEAD_SIZE[0] / 2 + 0.02) * ahead
        lit[:, 2] += np.array([height for _, height in lamps])
        lamp_boxes = box_corners_3d(lit, headings, np.tile((0.05, 0.28, 0.28), (count, 1)))
        materials = np.full((2 * count, 6), Material.SIGNAL_BOX)
        materials[count:, REAR] = np.array([material for material, _ in lamps], int).reshape(count)
        return Solids(
            np.concatenate([boxes, lamp_boxes]),
            COLORS[materials],
            materials,
            np.full(2 * count, SemanticClass.SIGNAL),
            np.full(2 * count, -1),
        )

    def shadows(
        self, step: int, position: Float64[np.ndarray, " 3"], to_sun: Float64[np.ndarray, " 3"]
    ) -> Float64[np.ndarray, "n 8 2"]:
        """Corners of near boxes and of their shadows' far ends, on the ground [m]; none without sun.

        A shadow is the convex hull of its eight corners.
        """
        rows, places = self.feet(step)
        near = np.abs(places[:, :2] - position[:2]).max(-1, initial=0.0) < _SHADOWS
        rows, places = rows[near & (to_sun[2] > 0.05)], places[near & (to_sun[2] > 0.05)]
        sizes = self._sizes[rows]
        bottom = box_corners_3d(places, self._log.headings[rows, step], sizes * [1.0, 1.0, 0.0])[:, :4, :2]
        shift = -to_sun[:2] / max(to_sun[2], 0.05) * (0.9 * sizes[:, 2:])
        return np.concatenate([bottom, bottom + shift[:, None]], 1)


def object_colors(names: Sequence[str], seed: int) -> Float64[np.ndarray, "n 3 3"]:
    """Colors of paint, cloth and trousers of objects, by their ids and the seed."""
    numbers = np.array([(zlib.crc32(name.encode()), 0) for name in names], np.int64).reshape(-1, 2)
    draws = hashed_numbers(numbers, seed)
    paints = np.searchsorted(np.cumsum(PAINT_SHARES[:-1]), draws[:, 0], side="right")
    colors = np.stack([PAINTS[paints], draws[:, 2:5], draws[:, 5:8]], 1)
    colors[:, 0] *= 0.85 + 0.25 * draws[:, 1:2]
    colors[:, 1], colors[:, 2] = 0.05 + 0.8 * colors[:, 1], 0.05 + 0.35 * colors[:, 2]
    return colors.clip(0, 1)
