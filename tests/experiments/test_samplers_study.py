"""The sweep end to end on an untrained model; what it says of made-up rows; what it refuses."""

from __future__ import annotations

import copy
import dataclasses
import json

import numpy as np
import pytest

import scjax
from experiments.studies import samplers as sweep_samplers
from experiments.studies.samplers_report import METRICS, draw, markdown, verdict, worse
from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.caption_features import embed_captions
from scjax.data.captions import add_captions
from scjax.models.denoiser.config import TextCondition
from scjax.synthetic.source import Worlds
from tests.factories.words import Words
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Captioned records, and a model that reads their words."""
    folder = tmp_path_factory.mktemp("sweep")
    build_records(Worlds(3, 6), folder / "records", BuildOptions(split_percent=50.0))
    add_captions(folder / "records", paraphrases=1, progress=False)
    embed_captions(folder / "records", Words(), progress=False)
    model = dataclasses.replace(tiny_model(TextCondition(Words.width)), text_encoder=Words.name)
    scjax.save(model, folder / "model")
    return folder


def run(folder, *more):
    sweep_samplers.main(
        [
            f"--model={folder / 'model'}",
            f"--records={folder / 'records'}",
            "--samples=4",
            "--samplers",
            "dpm++",
            "--steps",
            "3",
            f"--out={folder / 'out'}",
            *more,
        ]
    )


def test_a_sweep_end_to_end_goes_on_where_it_was_stopped(folder, capsys):
    run(folder, "--guidance", "2", "4")
    told = capsys.readouterr().out
    content = json.loads((folder / "out" / "sweep.json").read_text())
    names = [row["name"] for row in content["rows"]]
    assert names == ["ddpm 100, guidance 2", "dpm++ 3, guidance 2", "dpm++ 3, guidance 4"]
    assert content["reference"] == names[0] and content["verdict"] in told and "ddpm 100, guidance 2" in told
    for row in content["rows"]:
        assert row["seconds"] > 0 and row["scenes"] == 4 and row["metrics"].keys() == METRICS.keys()
        prompt = row["metrics"]["prompt"]
        assert 0 <= prompt["low"] <= prompt["value"] <= prompt["high"] <= 1
    assert (folder / "out" / "sweep.png").stat().st_size > 10_000
    assert "| dpm++ 3, guidance 4 | 3 |" in (folder / "out" / "sweep.md").read_text()

    files = {path: path.stat().st_mtime_ns for path in (folder / "out").glob("dd*.json")}
    lost = next((folder / "out").glob("dpm++-3-4-float32-*.json"))
    before = json.loads(lost.read_text())
    lost.unlink()
    run(folder, "--guidance", "2", "4")
    again = json.loads(lost.read_text())
    assert files == {path: path.stat().st_mtime_ns for path in files}
    assert {**again, "seconds": 0} == {**before, "seconds": 0}  # same keys, same scenes


def test_precisions_are_compared_with_the_first(folder, capsys):
    run(folder, "--compute", "float32", "bfloat16", "--samplers", "ddpm", "--guidance", "4")
    exact, *others = json.loads((folder / "out" / "sweep.json").read_text())["rows"]
    assert [row["name"] for row in (exact, *others)] == ["ddpm 100, float32", "ddpm 3, float32", "ddpm 3, bfloat16"]
    values = [[row["metrics"][name]["value"] for name in METRICS] for row in others]
    assert values[0] != values[1]  # the network really computed otherwise


def test_the_reference_is_made_anew_from_other_noise(folder, capsys):
    run(folder, "--guidance", "4", "--again", "1")
    first, anew, few = json.loads((folder / "out" / "sweep.json").read_text())["rows"]
    assert (first["name"], anew["name"], few["name"]) == ("ddpm 100", "ddpm 100, again 1", "dpm++ 3")
    assert first["metrics"] != anew["metrics"] and "By chance alone ddpm 100 is worse in " in capsys.readouterr().out


def test_mistakes_are_told(folder):
    with pytest.raises(SystemExit, match=r"'heun' .*choose one of ddpm, ddim, dpm"):
        run(folder, "--samplers", "heun")
    with pytest.raises(SystemExit, match="no model folder"):
        run(folder, "--model=nowhere")


def rows(spread=0.1):
    """A reference of 1 in everything, and a twin of 10 evaluations; draws of locations about them, noise apart."""
    rng = np.random.default_rng(0)
    metrics = {name: {"value": 1.0, "low": 0.8, "high": 1.2} for name in METRICS}
    reference = {"name": "ddpm 100", "series": "ddpm", "evaluations": 100, "seconds": 1.0, "metrics": metrics}
    reference["drawn"] = {name: 1 + 5 * spread * rng.normal(size=300) for name in METRICS}  # what locations differ by
    few = {**copy.deepcopy(reference), "name": "dpm++ 10", "series": "dpm++", "evaluations": 10}
    for column in few["drawn"].values():
        column += spread * rng.normal(size=300)
    return reference, few


def test_worse_is_what_chance_does_not_explain():
    reference, few = rows()
    assert worse(few, reference) == [] == worse(reference, reference)
    for name, off in (
        ("open_connections", 0.4),
        ("off_heading", 0.2),
        ("vehicles_on_lane", 0.4),
        ("connection_gap_m", -0.4),
    ):
        few["metrics"][name]["value"] += off  # of vehicles on a lane more is better, of gaps less
    assert worse(few, reference) == ["open_connections"]  # two deviations are chance where sixteen are looked at
    few["metrics"]["vehicles_on_lane"]["value"] = float("nan")
    assert "vehicles_on_lane" in (worse(few, reference) or [])
    still = {**copy.deepcopy(reference), "metrics": few["metrics"]}
    assert "off_heading" in (worse(still, reference) or [])  # it does not vary at all
    assert worse({**few, "drawn": {}}, reference) is None


def test_chance_finds_something_in_one_sweep_of_twenty():
    rng, found = np.random.default_rng(1), 0
    for _ in range(200):
        reference, few = rows()
        for name in METRICS:
            few["metrics"][name]["value"] += 0.1 * rng.normal()
        found += bool(worse(few, reference))
    assert 2 <= found <= 20


def test_the_verdict_takes_the_cheapest_of_those_inside(tmp_path):
    reference, ten = rows()
    six, four = copy.deepcopy(ten), copy.deepcopy(ten)
    six |= {"name": "dpm++ 6", "evaluations": 6}
    four |= {"name": "dpm++ 4", "evaluations": 4}
    four["metrics"]["prompt"]["value"] = 0.2
    every = [reference, ten, six, four]
    assert verdict(every, reference).startswith("Fewest steps that are not told from ddpm 100: dpm++ 6 (6 evaluations")
    ten["metrics"]["prompt"]["value"] = 0.2
    assert "All are told" in verdict(every, reference)  # six of a sampler that is worse with ten are inside by chance
    ten["metrics"]["prompt"]["value"] = 1.0
    assert "dpm++ 4 (4" in (told := verdict([reference, four], reference)) and "what the prompt asks for" in told
    assert verdict([reference], reference).startswith("Nothing to compare")
    anew = [{**four, "name": "ddpm 100, again 1", "again": 1}, {**six, "name": "ddpm 100, again 2", "again": 2}]
    assert verdict([*every, *anew], reference).endswith("s). By chance alone ddpm 100 is worse in 1, 0.")
    assert "| dpm++ 4 | 4 | 1 | what the prompt asks for |" in markdown(every, reference)
    figure = draw(every, reference, tmp_path / "sweep.png")
    assert len([panel for panel in figure.axes if panel.get_title()]) == len(METRICS) + 1
