"""The study of obedience with a judge of a few lines: rows, shares by group, and what it refuses."""

from __future__ import annotations

import dataclasses
import json

import pytest

import scjax
from experiments.studies import obedience
from scjax.models.denoiser.kinds import LANE_DIGITS, agent_digits
from tests.factories.outlines import outlines
from tests.factories.worlds import tiny_model

JUDGE = """
import argparse, csv, json, pathlib
import numpy as np
parser = argparse.ArgumentParser()
for name in ("--prompts", "--scenes", "--out"):
    parser.add_argument(name, type=pathlib.Path)
args = parser.parse_args()
args.out.mkdir(exist_ok=True)
rows, found = [], []
for line in map(json.loads, args.prompts.read_text().splitlines()):
    scene = np.load(args.scenes / line["id"] / "scene.npz")
    for key, number in line["asks"].items():
        held = int(len(scene["lanes"]) == number if key == "lanes_total" else len(scene["agents"]) == number + 1)
        rows.append({**{name: line[name] for name in ("id", "style", "language")}, "key": key, "held": held})
    found.append({"scenes": [{"faults": {"overlaps": int(line["id"] == "a")}}]})
with (args.out / "checks.csv").open("w") as file:
    writer = csv.DictWriter(file, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
(args.out / "results.json").write_text(json.dumps(found))
"""
LINES = [
    {"id": "a", "style": "terse", "language": "en", "prompt": "x", "asks": {"lanes_total": 2, "vehicles": 2}},
    {"id": "b", "style": "spoken", "language": "de", "prompt": "y", "asks": {"lanes_total": 9}},
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A judge, prompts with labels, and a model whose only outline has two lanes and three agents."""
    folder = tmp_path_factory.mktemp("obedience")
    (folder / "judge.py").write_text(JUDGE)
    (folder / "prompts.jsonl").write_text("".join(json.dumps(line) + "\n" for line in LINES))
    codec = tiny_model().codec
    model = tiny_model(agent_kinds=agent_digits(codec), lane_kinds=LANE_DIGITS)
    row = ((1, 2), (0, 0, 0), {"lanes_total": 2, "vehicles": 2})
    scjax.save(dataclasses.replace(model, outlines=outlines(row)), folder / "model")
    return folder


def run(folder, *more):
    arguments = [str(folder / "prompts.jsonl"), "--judge", str(folder / "judge.py"), "--model", str(folder / "model")]
    obedience.main([*arguments, "--runs", str(folder / "runs"), "--out", str(folder / "page"), *more])
    return json.loads((folder / "page.json").read_text())["rows"]


def test_shares_are_of_prompts_wishes_and_groups(folder):
    row = run(folder, "--rows", "labels as requests")["labels as requests"]
    assert row["prompts"] == [1, 2] and row["wishes"] == [2, 3]
    assert row["styles"] == {"spoken": [0, 1], "terse": [1, 1]}
    assert row["attributes"] == {"lanes_total": [1, 2], "vehicles": [1, 1]}
    assert row["faults"]["overlaps"] == [1, 2]
    assert "| labels as requests | 50.0 % of 2 | 66.7 % of 3 |" in (folder / "page.md").read_text()


def test_numbers_of_steps_have_a_table_of_their_own(folder):
    run(folder, "--rows", "labels as requests", "2 steps")
    page = (folder / "page.md").read_text()
    assert "| 2 steps | 50.0 % of 2 | 66.7 % of 3 |" in page.split("## Number of sampling steps")[1]
    assert "2 steps" not in page.split("## Number of sampling steps")[0].split("\n", 3)[3]


def test_rows_that_are_there_are_not_sampled_again(folder, monkeypatch):
    run(folder, "--rows", "labels as requests")
    monkeypatch.setattr(obedience, "sample_in_calls", None)
    assert run(folder, "--rows", "labels as requests")["labels as requests"]["wishes"] == [2, 3]


def test_distances_are_to_the_training_scenes(folder, world_records):
    run(folder, "--rows", "labels as requests", "--records", str(world_records))
    distances = json.loads((folder / "page.json").read_text())["distances"]
    assert set(distances) == {"labels as requests", "held-out records"}
    assert all(0 <= low <= middle <= high for low, middle, high in distances.values())
    assert "| held-out records |" in (folder / "page.md").read_text()


def test_a_judge_that_fails_is_named(folder, tmp_path):
    (tmp_path / "judge.py").write_text("raise SystemExit('no scenes')")
    with pytest.raises(SystemExit, match=r"judge\.py fails: no scenes"):
        run(folder, "--rows", "labels as requests", "--judge", str(tmp_path / "judge.py"))
