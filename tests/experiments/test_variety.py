"""The study of variety: copies have no distance, places come once, and pages name their numbers."""

from __future__ import annotations

import json

import pytest

import scjax
from experiments.studies import variety
from scjax.data import records
from scjax.data.measurements import MeasuredRecords
from scjax.evaluate.sources import RecordScenes
from scjax.language.attributes.vector import feature_names
from tests.factories.worlds import tiny_model


def test_copies_of_a_scene_have_no_distance(captioned_records):
    scenes = RecordScenes(str(captioned_records), "train").read([0, 0, 0])
    found = variety.spread(scenes)
    assert found["distance"] == [0, 0, 0] and found["agents"] == [float(scenes[0].num_agents), 0]


def test_every_place_comes_once_and_shows_the_request(captioned_records):
    folder = str(captioned_records)
    both = RecordScenes(folder, "train"), MeasuredRecords(folder, "train")
    scenes = variety.recorded_scenes(*both, {"vehicles": (1, None)}, 50, seed=0)
    stored = records.open_records(folder, "train")
    places = {records.read_record(stored, row).cluster for row in range(len(stored))}
    assert 2 <= len(scenes) <= len(places)
    with pytest.raises(ValueError, match="0 places"):
        variety.recorded_scenes(*both, {"vehicles": (60, None)}, 50, seed=0)


def test_the_page_has_a_row_for_the_world_and_one_for_samples(captioned_records, tmp_path, monkeypatch):
    monkeypatch.setattr(variety, "REQUESTS", {"traffic": {"vehicles": (1, None)}})
    scjax.save(tiny_model(attributes=feature_names()), tmp_path / "model")
    options = ["--records", str(captioned_records), "--model", str(tmp_path / "model"), "--samples", "2"]
    variety.main([*options, "--out", str(tmp_path / "page")])
    rows = json.loads((tmp_path / "page.json").read_text())["traffic"]
    assert rows["world"]["scenes"] == rows["samples"]["scenes"] == 2
    assert "| traffic | samples | 2 |" in (tmp_path / "page.md").read_text()
