"""Lane sections -> centerlines of their lanes, sampled as finely as their curvature asks."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.data.readers.opendrive.lane_sections import NO_WIDTH
from scjax.data.readers.opendrive.lateral import lane_borders
from scjax.data.readers.opendrive.roads import LaneSection, MapRoad, SectionLane
from scjax.scene.limits import MAX_COORDINATE
from scjax.scene.polyline import cumulative_length

MAX_DEVIATION = 0.005  # m between a centerline and its chords
MAX_STEP_TURN = np.deg2rad(3.0)  # between two chords
MIN_STEP, MAX_STEP = 0.1, 20.0  # m between two points of the reference line
MAX_STEP_OF_TAPERS = 1.5  # m, where a lane opens or closes
MIN_WIDTH = 0.1  # m; what is nowhere wider is no lane
MAX_POINTS = 20_000_000  # of a map; more would fill the memory
_PROBES_PER_STRETCH, _PROBE_STEP = 8, 2.0  # m
_SAME_PLACE = 0.01  # m between two places that are one; exporters write steps within a micrometer


class LaneKey(NamedTuple):
    """A lane of a map: road, number of the lane section on its side, lane id."""

    road: str
    section: int
    lane: int

    def __str__(self) -> str:
        return f"{self.road}.{self.section}.{self.lane}"


@dataclasses.dataclass(frozen=True)
class LaneLine:
    """The centerline of a lane of one section.

    Attributes:
      key: which lane.
      lane: as in the file.
      points: in driving direction [m]; as sampled, lanes of a section have them at the same places of the road.
      widths: at the points [m].
      in_junction, is_motorway: of its road.
    """

    key: LaneKey
    lane: SectionLane
    points: Float64[np.ndarray, "points 3"]
    widths: Float64[np.ndarray, " points"]
    in_junction: bool
    is_motorway: bool

    @property
    def length(self) -> float:
        """Length in the plane [m]."""
        return float(cumulative_length(self.points)[-1])


def sample_section(road: MapRoad, index: int, section: LaneSection) -> list[LaneLine]:
    """The centerlines of a section, from the reference line outward; those of lanes without width are left out.

    Raises:
      ValueError: a number of the file leads to an absurd coordinate; says where.
    """
    bounds = _stretches(road, section)
    with np.errstate(over="ignore", invalid="ignore"):
        probes = _places(bounds, np.ceil(np.diff(bounds) / _PROBE_STEP).astype(int) + _PROBES_PER_STRETCH)
        centers, widths = _centerlines(road, section, *probes, bounds)
        is_taper = bool(((widths[:, [0, -1]] < NO_WIDTH) & (widths.max(1, keepdims=True) > MIN_WIDTH)).any())
        counts = _piece_counts(bounds, probes[0], centers, MAX_STEP_OF_TAPERS if is_taper else MAX_STEP)
        if counts.sum() > MAX_POINTS:
            raise road.element.fault(f"its lanes would need {counts.sum()} points")
        centers, widths = _centerlines(road, section, *_places(bounds, counts), bounds)
    if not (np.abs(centers) < MAX_COORDINATE).all():
        raise road.element.fault(f"a lane in the section at s = {section.start:g} has NaN or absurd coordinates")
    lines = []
    for lane, points, width in zip(section.lanes, centers, widths, strict=True):
        if width.max() >= MIN_WIDTH:
            step = 1 if lane.forward else -1
            points, width = points[::step].copy(), width[::step].copy()
            key = LaneKey(road.id, index, lane.id)
            lines.append(LaneLine(key, lane, points, width, bool(road.junction), road.is_motorway))
    return lines


def _stretches(road: MapRoad, section: LaneSection) -> Float64[np.ndarray, " bounds"]:
    """Places where one of the curves or polynomials changes, with both ends of the section [m]."""
    cubics = [road.elevation, road.superelevation, road.lane_offset]
    cubics += [cubic for lane in section.lanes for cubic in (lane.width, lane.border) if cubic is not None]
    starts = np.concatenate([road.plan_view.starts, *(cubic.starts for cubic in cubics)])
    inner = np.unique(starts[(starts > section.start + _SAME_PLACE) & (starts < section.end - _SAME_PLACE)])
    inner = inner[np.diff(inner, prepend=-np.inf) > _SAME_PLACE]
    return np.concatenate([[section.start], inner, [section.end]])


def _places(bounds: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places s that divide every stretch into ``counts`` pieces, and places that say which record counts there."""
    row = np.repeat(np.arange(len(counts)), counts)
    part = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    start, step = bounds[:-1][row], (np.diff(bounds) / counts)[row]
    s = np.append(start + part * step, bounds[-1])
    middle = start + (part + 0.5) * step
    return s, np.append(middle, middle[-1])


def _piece_counts(bounds: np.ndarray, s: np.ndarray, centers: np.ndarray, max_step: float) -> np.ndarray:
    """Pieces of every stretch that keep chords near the curve, and turns small; by second differences at ``s``."""
    row = np.clip(np.searchsorted(bounds, s, side="right") - 1, 0, len(bounds) - 2)
    inner = np.flatnonzero((row[1:-1] == row[:-2]) & ((row[2:] == row[1:-1]) | (s[2:] == bounds[row[1:-1] + 1]))) + 1
    step = (s[inner + 1] - s[inner - 1]) / 2
    bend = np.linalg.norm(centers[:, inner + 1] - 2 * centers[:, inner] + centers[:, inner - 1], axis=-1) / step**2
    speed = np.linalg.norm(centers[:, inner + 1, :2] - centers[:, inner - 1, :2], axis=-1) / (2 * step)
    # A chord of a curve p(s) over h deviates by h² |p''| / 8 and turns by h |p''| / |p'|.
    turn = (bend / np.maximum(speed, 0.05)).max(0, initial=0.0)
    need = np.maximum(np.sqrt(bend.max(0, initial=0.0) / (8 * MAX_DEVIATION)), turn / MAX_STEP_TURN)
    need = np.nan_to_num(need, nan=1.0, posinf=1 / MIN_STEP)
    density = np.full(len(bounds) - 1, 1 / max_step)
    np.maximum.at(density, row[inner], np.minimum(need, 1 / MIN_STEP))
    return np.maximum(np.ceil(np.diff(bounds) * density - 1e-9).astype(int), 1)


def _centerlines(
    road: MapRoad, section: LaneSection, s: np.ndarray, at: np.ndarray, bounds: np.ndarray
) -> tuple[Float64[np.ndarray, "lanes n 3"], Float64[np.ndarray, "lanes n"]]:
    """Centerlines along the reference line [m] and widths [m] of all lanes at places s."""
    x, y, heading = road.plan_view.poses(s, at).T
    z, roll = road.elevation.values(s, at), road.superelevation.values(s, at)
    borders = lane_borders(road, section, s, at, bounds)
    middle = (borders[1:] + borders[:-1]) / 2
    across = middle * np.cos(roll)
    centers = np.stack([x - across * np.sin(heading), y + across * np.cos(heading), z + middle * np.sin(roll)], -1)
    return centers, np.abs(np.diff(borders, axis=0))
