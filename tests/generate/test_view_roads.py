"""Bins of windows that lanes go through, and how lanes that are seen fit them."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.generate.seen_lanes import SeenLanes
from scjax.generate.view_roads import BINS, SQUARES, lane_bins, misfits
from scjax.models.denoiser.kinds import SECTORS
from scjax.scene import Crop, empty


def window(*lines):
    """A window with straight lanes (x, y of the start, x, y of the end)."""
    one = empty(1, len(lines), crop=Crop.FORWARD)
    lanes = np.zeros(one.lanes.shape, np.float32)
    for row, (x, y, to_x, to_y) in enumerate(lines):
        lanes[row, :, 0] = np.linspace(x, to_x, lanes.shape[1])
        lanes[row, :, 1] = np.linspace(y, to_y, lanes.shape[1])
    return one.replace(lanes=lanes, lane_mask=np.ones(len(lines), bool), agent_mask=np.ones(1, bool))


AHEAD, ONCOMING, ACROSS = (0.0, 0.5, 64.0, 0.5), (64.0, 4.0, 0.0, 4.0), (30.0, -32.0, 30.0, 32.0)


def seen(*lines):
    """Points of lanes ahead and in view, a meter apart."""
    points, headings = [], []
    for x, y, to_x, to_y in lines:
        start, step = np.array([x, y]), np.array([to_x - x, to_y - y])
        length = np.hypot(*step)
        along = start + np.arange(0.5, length)[:, None] * step / length
        along = along[(along[:, 0] > 4) & (np.hypot(*along.T) < 40) & (np.abs(along[:, 1]) < 0.6 * along[:, 0])]
        points.append(along)
        headings.append(np.broadcast_to(step / length, along.shape))
    return SeenLanes(np.concatenate(points), np.concatenate(headings))


def test_a_lane_fills_the_squares_on_its_way_in_its_direction_alone():
    bins = np.unpackbits(lane_bins(window(AHEAD)), count=BINS).reshape(-1, SECTORS).astype(bool)
    on_lane = np.abs(SQUARES[:, 1] - 0.5) < 1.0
    np.testing.assert_array_equal(bins[:, 0], on_lane)
    assert not bins[:, 1:].any()


def test_padding_and_lanes_out_of_view_fill_nothing():
    one = window(AHEAD, (0.0, 30.0, 10.0, 30.0))
    assert not lane_bins(one.replace(lane_mask=np.array([False, True]))).any()


WINDOWS = [(AHEAD,), (AHEAD, ACROSS), (AHEAD, ONCOMING), (ONCOMING,), ((0.0, 12.0, 64.0, 12.0),), ()]


@pytest.mark.parametrize("row", range(3))
def test_the_window_of_the_lanes_that_are_seen_fits_best(row):
    roads = np.stack([lane_bins(window(*lines)) for lines in WINDOWS])
    found = misfits(roads, seen(*WINDOWS[row]))
    assert found.argmin() == row and found[row] < 0.1


def test_a_window_without_lanes_covers_none_and_one_with_more_lanes_is_worse():
    roads = np.stack([lane_bins(window(*lines)) for lines in WINDOWS])
    found = misfits(roads, seen(AHEAD))
    np.testing.assert_allclose(found[5], 1.0, atol=1e-6)
    assert found[1] > found[0] + 0.1 and found[2] > found[0] + 0.1


def test_windows_do_not_depend_on_each_other():
    roads = np.stack([lane_bins(window(*lines)) for lines in WINDOWS])
    lanes = seen(AHEAD, ACROSS)
    np.testing.assert_allclose(misfits(roads, lanes)[2:3], misfits(roads[2:3], lanes), rtol=1e-6)
