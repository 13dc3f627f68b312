"""A model gets the outlines of windows of some records."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import scjax
from experiments import window_outlines
from scjax.data import records
from scjax.generate.view_roads import lane_bins
from scjax.scene import Crop


def test_windows_of_records_become_the_outlines_and_the_map_stays(captioned_records):
    model = scjax.load()
    assert model.views is not None
    views = window_outlines.with_windows(model, str(captioned_records)).views
    stored = records.open_records(captioned_records, "train")
    scenes = [records.sample_scene(records.read_record(stored, row), Crop.FORWARD) for row in range(len(stored))]
    assert views is not None and views.roads is not None and len(views.domains) == len(stored)
    np.testing.assert_array_equal(views.roads, [lane_bins(model.codec.select(one)) for one in scenes])
    np.testing.assert_array_equal((views.lanes >= 0).sum(1), [len(one.lanes) for one in scenes])
    np.testing.assert_array_equal(views.weights, model.views.weights)


def test_a_model_without_views_is_refused(captioned_records):
    with pytest.raises(ValueError, match="chooses no outlines by pictures"):
        window_outlines.with_windows(dataclasses.replace(scjax.load(), views=None), str(captioned_records))


def test_missing_records_are_named(tmp_path, capsys):
    with pytest.raises(SystemExit, match=r"experiments\.window_outlines: .*nothing"):
        window_outlines.main(["--records", str(tmp_path / "nothing")])
