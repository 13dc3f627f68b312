"""Measured attributes beside records: one line each, refused where they do not fit."""

import gzip
import json
import shutil

import numpy as np
import pytest

from scjax.cli.data import main
from scjax.data import records
from scjax.data.build import build_records
from scjax.data.loader import LoaderConfig, training_batches
from scjax.data.measurements import MeasuredRecords, measurements_path
from scjax.language.attributes.table import measure_attributes
from scjax.language.attributes.vector import feature_names
from scjax.models.codec import scjax
from scjax.scene import Crop
from scjax.synthetic.source import Worlds


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured") / "records"
    build_records(Worlds(2, 3), folder)
    assert main(["attributes", str(folder), "--workers", "0"]) == 0
    return folder


@pytest.fixture
def copy(measured, tmp_path):
    """A folder of records that may be damaged."""
    return shutil.copytree(measured, tmp_path / "records")


def _rewrite(folder, change):
    path = measurements_path(folder, "train")
    lines = [json.loads(line) for line in gzip.decompress(path.read_bytes()).splitlines()]
    path.write_bytes(gzip.compress("".join(json.dumps(line) + "\n" for line in change(lines)).encode()))


def test_every_record_is_measured(measured):
    stored, read = records.open_records(measured, "train"), MeasuredRecords(measured, "train")
    assert len(stored) == len(read) > 1
    for row in (0, len(read) - 1):
        assert read[row] == measure_attributes(records.sample_scene(records.decode_record(stored[row])))


def test_batches_carry_requests_except_for_forward_windows(measured):
    config = LoaderConfig(batch_size=4, buckets=((61, 100),), crops=(1.0, 0.0, 1.0))
    read = MeasuredRecords(measured, "train")
    batches = training_batches(measured, scjax(), config, measurements=read)
    requested, forward = [], []
    for _ in range(5):
        batch = next(batches)
        assert batch.attributes.shape == (4, len(feature_names())) and batch.attributes.dtype == np.float32
        requested.append(batch.attributes.any(1))
        forward.append(np.asarray(batch.scene.crop) == Crop.FORWARD)
    requested, forward = np.concatenate(requested), np.concatenate(forward)
    assert forward.any() and not requested[forward].any()
    assert requested[~forward].mean() > 0.5


def test_batches_resume_with_the_same_requests(measured):
    config = LoaderConfig(batch_size=4, buckets=((61, 100),))
    read = MeasuredRecords(measured, "train")
    batches = training_batches(measured, scjax(), config, measurements=read)
    next(batches)
    state, expected = batches.state(), next(batches).attributes
    resumed = training_batches(measured, scjax(), config, measurements=read)
    resumed.restore(state)
    np.testing.assert_array_equal(next(resumed).attributes, expected)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda lines: [{**lines[0], "records": "x"}, *lines[1:]], "other records or attributes"),
        (lambda lines: [{**lines[0], "attributes": ["layout"]}, *lines[1:]], "other records or attributes"),
        (lambda lines: lines[:-1], "fewer lines than there are records"),
        (lambda lines: [lines[0], {**lines[1], "layout": ["X"]}, *lines[2:]], "line 2: layout cannot be measured as"),
        (lambda lines: [lines[0], {**lines[1], "vehicles": "many"}, *lines[2:]], "line 2: vehicles cannot be measured"),
        (lambda lines: [lines[0], {"layout": ["T"]}, *lines[2:]], "line 2: these are not the measurements of all"),
    ],
)
def test_measurements_that_do_not_fit_are_refused(copy, change, fault):
    _rewrite(copy, change)
    with pytest.raises(ValueError, match=rf"attributes-train.*{fault}.*run scjax data attributes"):
        _ = MeasuredRecords(copy, "train")[0]


def test_damaged_files_are_refused(copy):
    path = measurements_path(copy, "train")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ValueError, match=r"attributes-train.* is damaged"):
        MeasuredRecords(copy, "train")
    path.unlink()
    with pytest.raises(ValueError, match=r"attributes-train.* is not there: run scjax data attributes"):
        MeasuredRecords(copy, "train")
