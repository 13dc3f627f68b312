"""Programs of others open what is exported; each test skips where its environment is not installed."""

from __future__ import annotations

import json
import subprocess
from collections import Counter

import pytest

from consumers.check import CHECKS, CONSUMERS, run_consumer
from consumers.environments import make_environment
from consumers.inputs import read_prompts
from consumers.page import write_page
from scjax.export import export_log
from tests.factories.exports import consumer_python, crossing_log, two_lane_log
from tests.factories.logs import example_log

LOGS = {"crossing": crossing_log, "two lanes": two_lane_log, "example": example_log}


def _results(environment: str, script: str, *paths) -> list[dict]:
    command = [consumer_python(environment), str(CHECKS / script), *map(str, paths)]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = [line for line in process.stdout.splitlines() if line.startswith("RESULT ")]
    return [json.loads(line.removeprefix("RESULT ")) for line in lines]


def test_metadrive_replays_to_the_destination(tmp_path):
    consumer_python("metadrive")
    for make in (crossing_log, example_log):
        export_log(make(), tmp_path, "scenarionet")
    rows = _results("metadrive", "metadrive_replay.py", tmp_path)
    assert [row["arrive_dest"] for row in rows] == [True, True]


def test_netconvert_and_roadgen_read_opendrive(tmp_path):
    consumer_python("sumo")
    paths = [export_log(make(), tmp_path / f"{name}.xodr", "opendrive").paths[0] for name, make in LOGS.items()]
    rows = _results("sumo", "sumo_import.py", *paths)
    assert len(rows) == 6 and not [row for row in rows if not row["ok"]]
    assert [row["signal_programs"] for row in rows if row["consumer"] == "netconvert"] == [1, 0, 1]


def test_asam_rules_hold(tmp_path):
    consumer_python("asam")
    paths = export_log(crossing_log(), tmp_path / "drive.xosc", "openscenario").paths
    rows = _results("asam", "asam_rules.py", *paths)
    assert [row["ok"] for row in rows] == [True, True] and [row["completed"] for row in rows] == [17, 22]


def test_commonroad_reads_and_writes_the_scenario(tmp_path):
    consumer_python("commonroad")
    paths = [export_log(make(), tmp_path / f"{name}.xml", "commonroad").paths[0] for name, make in LOGS.items()]
    rows = _results("commonroad", "commonroad_scenario.py", *paths)
    assert not [row for row in rows if not row["ok"]] and [row["lights"] for row in rows] == [1, 0, 1]


def test_consumer_that_is_not_installed_gives_no_results(tmp_path):
    assert run_consumer("SUMO, roadgen", {"opendrive": [tmp_path / "x.xodr"]}, tmp_path) == []
    assert {one.script for one in CONSUMERS.values()} <= {path.name for path in CHECKS.iterdir()}


def test_unknown_consumer_is_refused(tmp_path):
    with pytest.raises(ValueError, match="'carla' is no consumer: choose from asam, commonroad, metadrive, sumo"):
        make_environment("carla", tmp_path)


def test_every_fifth_prompt_is_an_input(tmp_path):
    path = tmp_path / "prompts.txt"
    path.write_text("".join(f'{{"id": "p{k}", "prompt": "road {k}"}}\n' if k else "a road\n" for k in range(12)))
    assert read_prompts(path, 3) == {"line-1": "a road", "p5": "road 5", "p10": "road 10"}
    with pytest.raises(ValueError, match="has 3 prompts, every fifth line counted: 4 are needed"):
        read_prompts(path, 4)


def test_page_counts_and_lists_faults(tmp_path):
    rows = [
        {"consumer": "netconvert", "ok": True, "file": "0-worlds-a.xodr", "warnings_by_default": {"x": 1}},
        {"consumer": "netconvert", "ok": False, "file": "1-worlds-b.xodr", "warnings_by_default": {}, "example": ["x"]},
    ]
    write_page(tmp_path / "page.md", rows, {}, [], ["MetaDrive"], Counter({"worlds": 2, "generated": 1}))
    text = (tmp_path / "page.md").read_text()
    assert "2 worlds, 1 generated" in text and "| netconvert | 1 of 2 |  |" in text
    assert "| MetaDrive | not installed | not installed |" in text
    assert '- worlds-b.xodr, netconvert: {"example": ["x"]}' in text and "1 of 2 files give a warning" in text
