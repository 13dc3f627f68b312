"""The log type: properties, slices in time, and complaints that name the field."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import NO_EGO, LogMetadata, MapLane, validate_log
from tests.factories.logs import example_log, straight_lane


def test_log_properties():
    log = validate_log(example_log())
    assert (log.num_steps, log.num_objects) == (10, 3)
    assert log.dt == pytest.approx(0.1)
    assert np.isnan(log[3:4].dt)


def test_log_slice_selects_steps():
    log = example_log()
    part = validate_log(log[3:9])
    assert part.num_steps == 6 and part.num_objects == 3
    np.testing.assert_array_equal(part.timestamps, log.timestamps[3:9])
    np.testing.assert_array_equal(part.positions, log.positions[:, 3:9])
    np.testing.assert_array_equal(part.valid, log.valid[:, 3:9])
    np.testing.assert_array_equal(part.signal_states, log.signal_states[:, 3:9])
    assert part.lanes is log.lanes and part.object_ids == log.object_ids


def test_log_slice_with_stride():
    assert example_log()[::4].timestamps.tolist() == pytest.approx([100.0, 100.4, 100.8])


def test_select_steps_equals_slice():
    log = example_log()
    np.testing.assert_array_equal(log.select_steps([2, 3, 4]).headings, log[2:5].headings)


@pytest.mark.parametrize("steps", [[], [3, 2], [3, 3], [-1, 2], [9, 10]])
def test_select_steps_refuses_bad_indices(steps):
    with pytest.raises(ValueError, match="of a log of 10 steps: give increasing indices from 0 to 9"):
        example_log().select_steps(steps)


def test_log_index_refuses_single_steps():
    with pytest.raises(TypeError, match="sliced in time"):
        example_log()[3]  # pyright: ignore


def _nan_position(log):
    positions = log.positions.copy()
    positions[1, 2, 0] = np.nan
    return {"positions": positions}


def _infinite_heading(log):
    return {"headings": log.headings + np.inf}


def _lanes(lane: MapLane):
    return lambda log: {"lanes": (*log.lanes, lane)}


def _partly_known_z() -> MapLane:
    lane = straight_lane("d", 0, 9, 0)
    lane.points[2, 2] = np.nan
    return lane


def _no_steps(log):
    per_step = ("valid", "positions", "headings", "velocities", "signal_states")
    return {"timestamps": log.timestamps[:0]} | {name: getattr(log, name)[:, :0] for name in per_step}


FAULTS = {
    "no steps": (lambda log: _no_steps(log), "timestamps is empty"),
    "repeated times": (lambda log: {"timestamps": np.zeros(10)}, "timestamps must be finite and increase"),
    "repeated object": (lambda log: {"object_ids": ("a", "b", "a")}, "object_ids holds 'a' more than once"),
    "object type": (lambda log: {"object_types": np.array([0, 9, 0])}, r"object_types holds values outside -1\.\.3"),
    "position": (_nan_position, "positions of object 1 at step 2"),
    "heading": (_infinite_heading, "headings of object 0 at step 0"),
    "size": (lambda log: {"sizes": log.sizes + np.inf}, "sizes holds infinite"),
    "ego": (lambda log: {"ego_index": 3}, "ego_index 3 is not an index into the 3 objects"),
    "signal": (lambda log: {"signal_states": log.signal_states + 9}, r"signal_states holds values outside 0\.\.3"),
    "lane nan": (_lanes(straight_lane("d", 0, 9, np.nan)), "lane d has NaN"),
    "lane empty": (_lanes(MapLane("d", None, np.zeros((0, 3)))), "lane d has points of shape"),
    "lane z": (_lanes(_partly_known_z()), "lane d has z at some points only"),
    "repeated lane": (_lanes(straight_lane("a", 0, 9, 0)), "lanes holds 'a' more than once"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_validate_log_names_field_and_cause(fault):
    change, message = FAULTS[fault]
    log = example_log()
    with pytest.raises(ValueError, match=message):
        validate_log(dataclasses.replace(log, **change(log)))


def test_validate_log_ignores_invalid_steps():
    log = example_log()
    positions = log.positions.copy()
    positions[2, :4] = np.nan
    validate_log(dataclasses.replace(log, positions=positions))


def test_log_without_ego_or_metadata_is_valid():
    validate_log(example_log(ego_index=NO_EGO, metadata=LogMetadata()))
