"""The samplers study end to end on an untrained model, and what it refuses."""

from __future__ import annotations

import dataclasses
import json

import pytest

import scjax
from experiments.studies import samplers
from experiments.studies.samplers import Setting
from experiments.studies.samplers_report import METRICS
from scjax.models.denoiser.config import TextCondition
from tests.factories.words import Words
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory, captioned_records):
    """Captioned records, and a model that reads their words."""
    folder = tmp_path_factory.mktemp("samplers")
    (folder / "records").symlink_to(captioned_records)
    model = dataclasses.replace(tiny_model(TextCondition(Words.width)), text_encoder=Words.name)
    scjax.save(model, folder / "model")
    return folder


def run(folder, *more):
    arguments = [f"--model={folder / 'model'}", f"--records={folder / 'records'}", f"--workdir={folder / 'rows'}"]
    arguments += [f"--out={folder / 'page'}", "--samples=4", "--reference-steps=3", "--guidance=2", "--num-steps=2"]
    samplers.main([*arguments, "--samplers=dpm++", *more])
    return json.loads((folder / "page.json").read_text())


@pytest.fixture(scope="module")
def content(folder):
    """The page of a reference, its repeat, and two precisions of one setting."""
    return run(folder, "--repeats=1", "--compute", "float32", "bfloat16")


def test_study_names_its_rows(content):
    names = [row["name"] for row in content["rows"]]
    assert names == ["ddpm 3, float32", "ddpm 3, float32, repeat 1", "dpm++ 2, float32", "dpm++ 2, bfloat16"]
    assert content["reference"] == names[0]


def test_study_measures_every_row(content):
    for row in content["rows"]:
        assert row["seconds"] > 0 and row["scenes"] == 4 and row["metrics"].keys() == METRICS.keys()
        prompt = row["metrics"]["prompt"]
        assert 0 <= prompt["low"] <= prompt["value"] <= prompt["high"] <= 1


def test_repeat_samples_the_reference_from_other_noise(content):
    reference, repeat, *_ = content["rows"]
    assert reference["metrics"] != repeat["metrics"]
    assert "With other random numbers ddpm 3, float32 is worse in " in content["verdict"]


def test_precisions_compute_differently(content):
    *_, exact, rounded = content["rows"]
    values = [[row["metrics"][name]["value"] for name in METRICS] for row in (exact, rounded)]
    assert values[0] != values[1]


def test_study_writes_page_and_picture(content, folder):
    text = (folder / "page.md").read_text()
    assert "| dpm++ 2, bfloat16 | 2 |" in text and content["verdict"] in text
    assert "python -m experiments.studies.samplers --model=" in text
    assert (folder / "page.png").stat().st_size > 10_000


def test_study_samples_only_missing_rows(content, folder):
    times = {path: path.stat().st_mtime_ns for path in (folder / "rows").glob("*.json")}
    missing = next((folder / "rows").glob("dpm++-2-2-float32-*.json"))
    before = json.loads(missing.read_text())
    missing.unlink()
    run(folder, "--repeats=1", "--compute", "float32", "bfloat16")
    again = json.loads(missing.read_text())
    assert {**again, "seconds": 0} == {**before, "seconds": 0}  # same keys, same scenes
    del times[missing]
    assert times == {path: path.stat().st_mtime_ns for path in times}


def test_suffix_names_what_differs():
    setting = Setting("ddpm", 3, 2.0, "float32", repeat=1)
    assert setting.suffix(True, True) == ", guidance 2, float32, repeat 1"
    assert setting._replace(repeat=0).suffix(False, False) == ""


def test_study_refuses_samplers_that_do_not_fit(folder):
    with pytest.raises(SystemExit, match=r"'heun' .*choose one of ddpm, ddim, dpm"):
        run(folder, "--samplers", "heun")


def test_study_refuses_missing_models(folder):
    with pytest.raises(SystemExit, match="no model folder"):
        run(folder, "--model=nowhere")
