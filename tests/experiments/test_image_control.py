"""The study of image control: what is seen of scenes made by hand, and a whole page by a tiny model."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

import scjax
from experiments.studies import image_control
from experiments.studies.image_control_measures import View, agreement_ratios, lane_points, picture_ratios
from scjax.data import records
from scjax.encoders import load_image_encoder
from scjax.generate.picture_networks import ENCODER_VARIABLE
from scjax.scene import Crop
from tests.factories.image_folders import picture, write_network
from tests.factories.pictures import picture_model
from tests.factories.traffic import agent, lane, scene

pytest.importorskip("cv2")
LANES = [lane((0, 0), (60, 0)), lane((60, 4), (0, 4))]


def ahead(agents, lanes=LANES):
    return scene([agent(0, 0), *agents], lanes).replace(crop=np.asarray(Crop.FORWARD, np.int32))


TRUE = ahead([agent(15, 0, size=(8.0, 2.5, 3.0)), agent(25, 0), agent(22, 8), agent(10, 25)])
VIEW = View(TRUE)


def shares(generated, reference=TRUE, view=VIEW):
    ratios = picture_ratios(reference, generated, view)
    return {name: part / whole if whole else None for name, (part, whole) in ratios.items()}


def test_vehicles_behind_others_and_beside_the_picture_are_not_seen():
    assert VIEW.vehicles.tolist() == [False, True, False, True, False]


def test_ground_behind_boxes_and_beside_the_picture_is_not_seen():
    places = np.array([[9.0, 0], [40, 0], [40, 8], [10, 25], [-5, 0], [1, 0]])
    assert VIEW.sees(places).tolist() == [True, False, True, False, False, False]


def test_cells_of_a_picture_say_what_buildings_hide(tmp_path):
    objects, lanes = np.zeros((28, 28, 7), np.float16), np.zeros((28, 28, 6), np.float16)
    objects[3, 3] = (15, 0, 1, 0, 4, 2, 1)
    lanes[:, 0] = np.column_stack([np.linspace(4, 30, 28), *np.zeros((4, 28)), np.ones(28)])
    np.savez(tmp_path / "cells.npz", objects=objects, lanes=lanes)
    view = View(TRUE, tmp_path / "cells.npz")
    assert view.vehicles.tolist() == [False, True, False, False, False]
    places = np.array([[9.0, 0], [12, 4], [45, 8]])
    assert VIEW.sees_road(places).all() and view.sees_road(places).tolist() == [True, False, False]


def test_a_scene_fits_its_own_picture():
    own = shares(TRUE)
    assert own["vehicles_1m"] == own["vehicles_2m_20_40"] == own["lanes_1m"] == own["lanes_precise_1m"] == 1
    assert own["recall_1m"] == own["precision_1m"] == 1
    assert own["invented"] == own["invented_per_picture"] == own["overlapping"] == 0


def test_displaced_vehicles_match_within_their_distance():
    moved = shares(ahead([agent(16.5, 0), agent(22, 8.5)]))
    assert (moved["vehicles_1m"], moved["vehicles_2m"]) == (0.5, 1)
    assert (moved["vehicles_2m_0_20"], moved["vehicles_1m_0_20"]) == (1, 0)


def test_vehicles_where_the_road_is_seen_empty_are_invented():
    for place, count in (((8, 4), 1), ((40, 0), 0), ((15, 2), 0), ((12, -12), 0)):  # empty, hidden, taken, no road
        one = shares(ahead([agent(*place)]))
        assert one["invented_per_picture"] == one["clearly_per_picture"] == count, place
    misplaced = shares(ahead([agent(30, 4)]))  # 4 m beside another
    assert misplaced["invented_per_picture"] == 1 and misplaced["clearly_per_picture"] == 0


def test_lanes_that_are_not_there_or_head_elsewhere_are_counted():
    other = shares(ahead([], [lane((60, 0), (0, 0)), lane((0, -8), (60, -8))]))
    assert other["lanes_3m"] == other["lanes_precise_3m"] == 0
    half = shares(ahead([], [*LANES[:1], lane((0, -8), (60, -8))]))
    assert 0.1 < half["lanes_1m"] < 0.5 and 0 < half["lanes_precise_2m"] < 1


def test_points_of_lanes_are_a_meter_apart():
    points, headings = lane_points(TRUE)
    assert len(points) == 120 and set(headings.round(3)) == {0, 3.142}
    np.testing.assert_allclose(points[:2], [[0.5, 0], [1.5, 0]])


def test_samples_agree_where_they_are_alike():
    one = ahead([agent(15, 0), agent(8, 25)], [*LANES, lane((8, 20), (8, 30))])
    other = ahead([agent(15, 1), agent(8, -25)])
    ratios = agreement_ratios([one, other], VIEW)
    agreement = {name: part / whole for name, (part, whole) in ratios.items()}
    assert agreement["lanes_in_view"] == agreement["vehicles_in_view"] == 1
    assert 0 < agreement["lanes_elsewhere"] < 0.8 and agreement["vehicles_elsewhere"] == 0


@pytest.fixture
def pictures(captioned_records, tmp_path, monkeypatch):
    """Pictures of some records, and a model that reads them."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for split in ("train", "val"):
        for row in range(min(4, len(records.open_records(captioned_records, split)))):
            Image.fromarray(picture(seed=row)).save(folder / f"{split}-{row:06d}.jpg")
    monkeypatch.setenv(ENCODER_VARIABLE, str(write_network(tmp_path / "encoder")))
    encoder = load_image_encoder(tmp_path / "encoder")
    scjax.save(picture_model(image_encoder=encoder.name, num_steps=2, guidance=1.0), tmp_path / "model")
    return folder


def test_the_page_has_all_rows_and_examples(captioned_records, pictures, tmp_path):
    options = ["--records", captioned_records, "--pictures", pictures, "--model", tmp_path / "model"]
    options += ["--number", 3, "--samples", 2, "--candidates", 3, "--out", tmp_path / "page"]
    image_control.main([str(word) for word in options])
    content = json.loads((tmp_path / "page.json").read_text())
    assert content["scenes"] == 3 and len(content["rows"]) == 8
    text = (tmp_path / "page.md").read_text()
    for name in content["rows"]:
        assert text.count(f"| {name} | ") == 5 + (name == "picture")
    assert "![Pictures and scenes](page.jpg)" in text
    with Image.open(tmp_path / "page.jpg") as image:
        assert image.format == "JPEG" and (tmp_path / "page.jpg").stat().st_size <= 60_000


def test_missing_pictures_are_named(captioned_records, pictures, tmp_path, capsys):
    options = ["--records", captioned_records, "--pictures", tmp_path, "--model", tmp_path / "model"]
    with pytest.raises(SystemExit, match=r"there are no pictures val-ROW\.jpg: make them with scjax data dashcam"):
        image_control.main([str(word) for word in [*options, "--out", tmp_path / "page"]])
