"""Logs in files: exact round trips, and complaints that name the file."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from scjax.scene import Log, load_log, save_log
from tests.factories.logs import example_log

LOGS = {
    "example": example_log,
    "one step": lambda: example_log()[2:3],
    "no lanes": lambda: example_log(lanes=()),
}


def assert_same_log(first: Log, second: Log) -> None:
    for field in dataclasses.fields(Log):
        one, two = getattr(first, field.name), getattr(second, field.name)
        if isinstance(one, np.ndarray):
            assert one.dtype == two.dtype, field.name
            np.testing.assert_array_equal(one, two, err_msg=field.name)
        elif field.name != "lanes":
            assert one == two, field.name
    for one, two in zip(first.lanes, second.lanes, strict=True):
        np.testing.assert_array_equal(one.points, two.points)
        assert dataclasses.replace(one, points=two.points) == two


@pytest.mark.parametrize("name", LOGS)
def test_log_round_trip_is_exact(name, tmp_path):
    log, path = LOGS[name](), tmp_path / "new" / "log.npz"
    save_log(log, path)
    assert_same_log(load_log(path), log)
    assert [file.name for file in path.parent.iterdir()] == ["log.npz"]


def test_save_log_refuses_invalid_logs(tmp_path):
    with pytest.raises(ValueError, match="ego_index"):
        save_log(example_log(ego_index=9), tmp_path / "log.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("size", [0, 10, 400, -30])
def test_load_log_truncated_file(size, tmp_path):
    path = tmp_path / "short.npz"
    save_log(example_log(), path)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError, match=r"short\.npz is no readable .npz file"):
        load_log(path)


def test_load_log_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_log(tmp_path / "log.npz")


def _header(**changes):
    def change(arrays):
        arrays["header"] = json.dumps(json.loads(str(arrays["header"])) | changes)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_header(format="other"), "is no log"),
        (_header(version=2), "format version 2, this scjax reads 1"),
        (_header(ego_index=7), "invalid log: ego_index 7"),
        (_header(lanes=[]), "invalid log"),
        (lambda arrays: arrays.pop("header"), "is no log"),
        (lambda arrays: arrays.pop("headings"), r"lacks the arrays \['headings'\]"),
        (lambda arrays: arrays.update(valid=arrays["valid"] * 1.5), "valid has the type float64"),
    ],
)
def test_load_log_fault_names_file_and_cause(change, message, tmp_path):
    path = tmp_path / "mine.npz"
    save_log(example_log(), path)
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(ValueError, match=rf"mine\.npz.*{message}"):
        load_log(path)
