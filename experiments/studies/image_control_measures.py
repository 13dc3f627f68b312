"""How well a scene fits the picture of another one: in what the picture shows, and how far samples agree elsewhere."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scjax.camera import ElementKind, WireframeRenderer, WireframeStyle, preset_rig, project_points
from scjax.metrics.lanes import lane_arc_lengths, lane_segments, nearest_segment
from scjax.metrics.lines import resample_polylines
from scjax.metrics.placement import (
    THRESHOLDS,
    camera,
    compared_agents,
    distances,
    greedy_matches,
    match,
    typed_positions,
)
from scjax.metrics.pooling import Ratios
from scjax.metrics.realism import scene_realism
from scjax.scene import AgentType, Scene

VEHICLES = (AgentType.VEHICLE,)
RANGES = ((0, 20), (20, 40), (0, 40), (40, 64))
"""Distances from the ego [m], by which what is seen is counted."""

NEAR = RANGES[2][1]
"""What is called near lies nearer than this [m]."""

REGION = camera(1030.0, 1280.0, 0.2)
"""The dashcam's field of view."""

SIZE = (320, 176)  # pixels of the view
LEAST_PIXELS = 16  # of a box that is seen, of 56,320
_FIRST = 3.0  # m ahead; the ground nearer than this is below the picture
_ON_ROAD = 1.75  # m from a centerline
_CLEAR, _CLEAR_SHARE = 3.0, 0.2  # m around a place where no box is, and share of its distance
_SAME_PLACE, _SAME_SHARE = 2.0, 0.2  # m, and share of the distance: how far what a cell shows lies from its middle
_INSIDE = 6.0  # m that the middle of a vehicle lies behind the side of it that is seen
_HEADING = np.deg2rad(30.0)
_AGREE_LANE, _AGREE_VEHICLE = 1.0, 2.0  # m


class View:
    """What a dashcam on the ego of a scene sees of it. Boxes hide what is behind them.

    Args:
      scene: single, in the forward window.
      cells: file of ``scjax data dashcam`` beside a picture of the scene, which knows of buildings too; if it is there,
        vehicles and lanes count only where it has them.

    Attributes:
      vehicles: which agents are vehicles that are seen.
    """

    def __init__(self, scene: Scene, cells: Path | None = None):
        rig = preset_rig("dashcam").fitted(*SIZE)
        renderer = WireframeRenderer(scene, rig, style=WireframeStyle(borders=False))
        frame = renderer.frame(0, buffers=True)
        assert frame.depth is not None and frame.ids is not None and frame.kinds is not None
        self._camera, self._rotation = renderer.camera, renderer.poses.rotations[0]
        self._position = renderer.poses.translations[0]
        self._foot = float(scene.agents[0, 2] - scene.agents[0, 8] / 2)
        is_box = frame.kinds == ElementKind.BOX
        self._walls = np.where(is_box, frame.depth, np.inf)
        pixels = np.bincount(frame.ids[is_box], minlength=len(scene.agents))[: len(scene.agents)]
        self.vehicles = compared_agents(scene, VEHICLES) & (pixels >= LEAST_PIXELS)
        self._road: np.ndarray | None = None
        if cells is not None and cells.is_file():
            with np.load(cells) as arrays:
                objects, lanes = (arrays[name].reshape(-1, arrays[name].shape[-1]) for name in ("objects", "lanes"))
            self._road = lanes[lanes[:, -1] > 0, :2].astype(np.float64)
            shown = objects[objects[:, -1] > 0, :2].astype(np.float64)
            self.vehicles &= _gaps(scene.agents[:, :2].astype(np.float64), shown) < 1.0

    def sees(self, points: np.ndarray, slack: float = 0.5) -> np.ndarray:
        """Which places of the ground [n, 2] are in the picture, and not more than ``slack`` [m] behind a side of a
        box."""
        ground = np.column_stack([points[:, :2], np.full(len(points), self._foot)])
        image = project_points(self._camera, (ground - self._position) @ self._rotation)
        columns, rows = np.round(np.where(image.visible[:, None], image.pixels, -1)).astype(int).T
        inside = image.visible & (columns >= 0) & (columns < SIZE[0]) & (rows >= 0) & (rows < SIZE[1])
        walls = self._walls[np.where(inside, rows, 0), np.where(inside, columns, 0)]
        return inside & (points[:, 0] >= _FIRST) & (image.depth <= walls + slack)

    def sees_road(self, points: np.ndarray) -> np.ndarray:
        """Which places on the road [n, 2] are seen; as ``sees``, and not behind a building if that is known."""
        seen = self.sees(points)
        if self._road is None:
            return seen
        return seen & (_gaps(points, self._road) < np.maximum(_SAME_PLACE, _SAME_SHARE * points[:, 0]))


def picture_ratios(reference: Scene, generated: Scene, view: View) -> Ratios:
    """Numerators and denominators of one scene and the picture of its reference.

    Returns:
      vehicles_1m ...: vehicles that are seen, with a generated one so near; vehicles_2m_0_20 ...: by their distance.
      recall_, precision_: of all vehicles in the field of view (``placement.match``).
      lanes_1m ...: points of lanes that are seen, with a generated lane so near that heads the same way within 30
        degrees; lanes_2m_0_20 ...: by their distance. lanes_precise_1m ...: near points of generated lanes in view,
        with a lane so near that heads the same way.
      overlapping: vehicles that overlap another. invented: of the near vehicles in the field of view, those on the
        road where it is seen and empty; invented_per_picture: their number; clearly_per_picture: the number of those
        that are no misplaced ones, with no box within a fifth of their distance either.
    """
    ratios: Ratios = match(reference, generated, types=VEHICLES, region=REGION)
    theirs = typed_positions(reference)[view.vehicles]
    reach = np.hypot(theirs[:, 0], theirs[:, 1])
    order = np.argsort(reach, kind="stable")
    ours = typed_positions(generated)[compared_agents(generated, VEHICLES)]
    for threshold in THRESHOLDS:
        matched = greedy_matches(distances(theirs[order], ours), threshold)
        ratios |= _by_range(f"vehicles_{threshold:g}m", matched, reach[order])
    own, true = lane_segments(generated), lane_segments(reference)
    points, headings = lane_points(reference)
    seen = view.sees_road(points)
    points, headings = points[seen], headings[seen]
    gaps = lane_gaps(points, headings, own)
    for threshold in THRESHOLDS:
        ratios |= _by_range(f"lanes_{threshold:g}m", gaps < threshold, np.hypot(*points.T))
    points, headings = lane_points(generated)
    chosen = view.sees(points) & (np.hypot(*points.T) < NEAR)
    gaps = lane_gaps(points[chosen], headings[chosen], true)
    for threshold in THRESHOLDS:
        ratios[f"lanes_precise_{threshold:g}m"] = (float((gaps < threshold).sum()), float(len(gaps)))
    ratios["overlapping"] = scene_realism(generated)["vehicles_overlapping"]
    return ratios | _invented(reference, ours[:, :2], view)


def agreement_ratios(samples: Sequence[Scene], view: View) -> Ratios:
    """How often samples of one picture agree with each other near the ego: in view, and beside the picture.

    Returns:
      lanes_in_view, lanes_elsewhere: points of a sample's lanes with a lane of another sample within 1 m that heads
        the same way;
      vehicles_in_view, vehicles_elsewhere: its vehicles with one of another sample within 2 m.
    """
    names = [f"{what}_{where}" for what in ("lanes", "vehicles") for where in ("in_view", "elsewhere")]
    sums = {name: np.zeros(2) for name in names}
    points = [lane_points(scene) for scene in samples]
    vehicles = [typed_positions(one)[compared_agents(one, VEHICLES), :2] for one in samples]
    for i, j in itertools.permutations(range(len(samples)), 2):
        near_lane = lane_gaps(*points[i], lane_segments(samples[j])) < _AGREE_LANE
        near_vehicle = _gaps(vehicles[i], vehicles[j]) < _AGREE_VEHICLE
        pairs = (
            ("lanes", points[i][0], near_lane, view.sees(points[i][0])),
            ("vehicles", vehicles[i], near_vehicle, view.sees(vehicles[i], _INSIDE)),
        )
        for what, places, agree, seen in pairs:
            near = (places[:, 0] >= _FIRST) & (np.hypot(*places.T) < NEAR)
            for where, chosen in (("in_view", near & seen), ("elsewhere", near & ~REGION(places))):
                sums[f"{what}_{where}"] += agree[chosen].sum(), chosen.sum()
    return {name: (float(pair[0]), float(pair[1])) for name, pair in sums.items()}


def lane_points(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Points along all lanes, a meter apart [n, 2], and the headings there [rad]."""
    parts, headings = [np.zeros((0, 2))], [np.zeros(0)]
    lengths = lane_arc_lengths(scene)
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask), :, :2]
    for lane, length in zip(lanes, lengths.tolist(), strict=True):
        line = resample_polylines(lane[None], max(2, round(length) + 1))[0]
        steps = np.diff(line, axis=0)
        parts.append(line[:-1] + steps / 2)
        headings.append(np.arctan2(steps[:, 1], steps[:, 0]))
    return np.concatenate(parts), np.concatenate(headings)


def lane_gaps(points: np.ndarray, headings: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance of each point [n, 2] from the nearest segment that heads the same way within 30 degrees [m]; inf without
    one.

    Args:
      headings: of the points [rad].
      segments: as of ``lane_segments``.
    """
    start, along = segments[:, 0, :2], segments[:, 1, :2] - segments[:, 0, :2]
    square = np.maximum((along**2).sum(-1), 1e-12)
    offset = points[:, None] - start
    share = np.clip((offset * along).sum(-1) / square, 0.0, 1.0)
    distance = np.linalg.norm(offset - share[..., None] * along, axis=-1)
    turn = np.arctan2(along[:, 1], along[:, 0]) - headings[:, None]
    return np.where(np.cos(turn) > np.cos(_HEADING), distance, np.inf).min(1, initial=np.inf)


def _by_range(name: str, hits: np.ndarray, reach: np.ndarray) -> Ratios:
    """All, and those of each range."""
    ratios: Ratios = {name: (float(hits.sum()), float(len(hits)))}
    for low, high in RANGES:
        inside = (reach >= low) & (reach < high)
        ratios[f"{name}_{low}_{high}"] = (float(hits[inside].sum()), float(inside.sum()))
    return ratios


def _invented(reference: Scene, places: np.ndarray, view: View) -> Ratios:
    places = places[(np.hypot(*places.T) < NEAR) & REGION(places)]
    on_road = nearest_segment(places, lane_segments(reference))[0] < _ON_ROAD
    gaps = _box_gaps(places, np.asarray(reference.agents, np.float64))
    empty = on_road & (gaps > _CLEAR) & view.sees_road(places)
    count, clearly = float(empty.sum()), float((empty & (gaps > _CLEAR_SHARE * np.hypot(*places.T))).sum())
    return {
        "invented": (count, float(len(places))),
        "invented_per_picture": (count, 1.0),
        "clearly_per_picture": (clearly, 1.0),
    }


def _box_gaps(places: np.ndarray, agents: np.ndarray) -> np.ndarray:
    """Distance of each place [n, 2] from the nearest box [m]; inf without boxes."""
    offset = places[:, None] - agents[None, :, :2]
    cos, sin = agents[None, :, 4], agents[None, :, 5]
    along, across = offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin
    outside = np.maximum(np.abs([along, across]) - agents[None, :, 6:8].transpose(2, 0, 1) / 2, 0.0)
    return np.hypot(*outside).min(1, initial=np.inf)


def _gaps(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance of each place [n, 2] from the nearest other [m]; inf without others."""
    return np.linalg.norm(places[:, None] - others[None], axis=-1).min(1, initial=np.inf)
