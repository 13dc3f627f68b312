"""Lanes side by side are lanes of one road in OpenDRIVE files."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.spatial import KDTree

from scjax.export.base import Losses
from scjax.export.opendrive import road_network
from scjax.export.roads.lane_borders import at_fewer_stations, lane_arcs
from scjax.export.roads.lane_curves import curve_frames, fit_curve
from scjax.export.roads.planned_road import PlannedRoad
from scjax.export.roads.wide_roads import wide_roads
from tests.factories.exports import two_lane_log


def planned(id: int, line, before: int = 0, after: int = 0) -> PlannedRoad:
    points = np.column_stack([np.array(line, float), np.zeros(len(line))])
    steps = np.diff(points[[0, 1, -2, -1], :2], axis=0)[[0, 2]]
    start, end = np.arctan2(steps[:, 1], steps[:, 0]).tolist()
    curve = fit_curve(points, start, end)
    return PlannedRoad(id, curve, id - 1, 0.0, (id - 1,), junction_before=before, junction_after=after)


def straight(y: float, start: float = 0.0, end: float = 30.0, slope: float = 0.0) -> np.ndarray:
    x = np.linspace(start, end, 21)
    return np.stack([x, y + slope * x], -1)


def numbers(roads) -> list[list[tuple[int, int]]]:
    """(id of the road of one lane, number) of all lanes of the roads."""
    return [[(lane.road.id, lane.number) for lane in road.lanes] for road in roads]


def test_lanes_of_one_direction_are_one_road():
    roads = wide_roads([planned(1, straight(0.0)), planned(2, straight(3.5)), planned(3, straight(-3.4))], [None] * 3)
    assert numbers(roads) == [[(2, -1), (1, -2), (3, -3)]]
    widths = -np.diff(roads[0].borders.offsets, axis=1)
    np.testing.assert_allclose(widths, np.tile([3.5, 3.5, 3.3], (len(widths), 1)), atol=0.1)


def test_two_directions_are_one_road_where_they_keep_right():
    forward, backward = straight(0.0), straight(3.5)[::-1]
    assert numbers(wide_roads([planned(1, forward), planned(2, backward)], [None] * 2)) == [[(2, 1), (1, -1)]]
    kept_left = wide_roads([planned(1, forward[::-1]), planned(2, backward[::-1])], [None] * 2)
    assert numbers(kept_left) == [[(1, -1)], [(2, -1)]]


@pytest.mark.parametrize(
    "other",
    [straight(2.0), straight(6.0), straight(3.5, 0.0, 3.0), straight(3.5, slope=0.5), straight(3.5, 20.0, 60.0)],
    ids=["on top", "far", "short", "turning away", "staggered"],
)
def test_lanes_that_are_not_beside_each_other_stay_two_roads(other):
    assert len(wide_roads([planned(1, straight(0.0)), planned(2, other)], [None] * 2)) == 2


def test_lanes_of_two_kinds_or_other_junctions_stay_two_roads():
    roads = [planned(1, straight(0.0)), planned(2, straight(3.5))]
    assert len(wide_roads(roads, ["freeway", "bike_lane"])) == 2
    assert len(wide_roads([planned(1, straight(0.0)), planned(2, straight(3.5), after=1)], [None] * 2)) == 2


def test_road_ends_where_its_first_lane_enters_the_junction():
    """What is cut off from the other lane becomes the first part of its way."""
    long, short = planned(1, straight(0.0, 0.0, 30.0), after=1), planned(2, straight(3.5, 0.0, 26.0), after=1)
    ways = [planned(3, straight(0.0, 30.0, 40.0)), planned(4, straight(3.5, 26.0, 40.0))]
    out = [planned(5, straight(0.0, 40.0, 60.0), before=1), planned(6, straight(3.5, 40.0, 60.0), before=1)]
    for way, before, after in zip(ways, (1, 2), (5, 6), strict=True):
        way.junction, way.before, way.after = 1, before, after
    roads = wide_roads([long, short, *ways, *out], [None] * 6)
    by_lane = {lane.road.id: road for road in roads for lane in road.lanes}
    assert by_lane[1] is by_lane[2] and by_lane[5] is by_lane[6]
    assert by_lane[1].curve.length == pytest.approx(26.0, abs=0.01)
    assert by_lane[3].curve.length == pytest.approx(14.0, abs=0.01)
    assert by_lane[4].curve.length == pytest.approx(14.0, abs=0.01)


def test_road_is_as_long_as_its_longest_lane_at_an_open_end():
    (road,) = wide_roads([planned(1, straight(0.0, 2.0, 30.0)), planned(2, straight(3.5, 0.0, 33.0))], [None] * 2)
    assert road.curve.length == pytest.approx(33.0, abs=0.01)


@pytest.mark.parametrize("radius", [15.0, 40.0])
def test_lanes_of_a_bend_stay_where_they_were(radius):
    angle = np.linspace(0.0, 1.5, 60)
    lines = [np.stack([r * np.sin(angle), r * np.cos(angle)], -1) for r in (radius, radius + 3.2 + 0.2 * angle)]
    (road,) = wide_roads([planned(1, lines[0]), planned(2, lines[1])], [None] * 2)
    borders = road.borders
    places, headings = curve_frames(road.curve, borders.stations)
    aside = np.stack([-np.sin(headings), np.cos(headings)], -1)
    for row, line in enumerate(lines[::-1]):
        beyond = np.concatenate([[2 * line[0] - line[1]], line, [2 * line[-1] - line[-2]]])
        rows = np.linspace(0, 61, 4000)
        dense = np.stack([np.interp(rows, np.arange(62), column) for column in beyond.T], -1)
        middle = places + borders.offsets[:, row : row + 2].mean(1)[:, None] * aside
        assert KDTree(dense).query(middle)[0].max() < 0.1


def test_widths_change_at_points_that_netconvert_puts_on_the_road():
    x = np.linspace(0.0, 60.0, 61)
    lines = [
        np.stack([x, 4 * np.sin(x / 12) + offset + aside * np.cos(x / 5)], -1) for offset, aside in ((0, 0), (3.5, 0.3))
    ]
    (road,) = wide_roads([planned(1, lines[0]), planned(2, lines[1])], [None] * 2)
    assert road.borders is not None
    borders = at_fewer_stations(road.borders)
    starts = np.cumsum([0.0, *road.curve.lengths])
    points = [np.linspace(a, b, int(np.ceil((b - a) / 2.0)) + 1) for a, b in itertools.pairwise(starts)]
    assert len(borders.stations) > 3
    assert np.abs(borders.stations[:, None] - np.concatenate(points)).min(1).max() < 1e-9


def test_lane_arcs_are_on_the_lines_across():
    reference, curve = planned(1, straight(0.0)).curve, planned(2, straight(3.5, 2.0, 28.0, 0.1)).curve
    stations = np.array([0.0, 10.0, 30.0])
    arcs = lane_arcs(reference, curve, stations)
    assert arcs is not None and arcs[0] < 0 < arcs[1] < curve.length < arcs[2]
    np.testing.assert_allclose(curve_frames(curve, arcs)[0][:, 0], stations, atol=1e-3)
    assert lane_arcs(reference, planned(2, straight(0.0)[:, ::-1] + 3.0).curve, stations) is None


def test_lanes_side_by_side_that_stay_apart_are_said():
    log, losses = two_lane_log(), Losses()
    road_network(log, losses)
    assert losses["pairs of lanes side by side that are lanes of two roads"] == 0
    first, second = log.lanes
    other = dataclasses.replace(log, lanes=(first, dataclasses.replace(second, lane_type="bike_lane")))
    road_network(other, losses)
    assert losses["pairs of lanes side by side that are lanes of two roads"] == 1
