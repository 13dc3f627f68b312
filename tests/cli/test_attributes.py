"""scjax attributes on files of scenes."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from scjax.cli.attributes import attributes_command
from scjax.language.attributes.table import ATTRIBUTES
from scjax.scene.io import save_npz
from tests.factories.road_scenes import straight_road


@pytest.fixture
def file(tmp_path):
    save_npz(straight_road(2, 1).scene(), tmp_path / "road.npz")
    return str(tmp_path / "road.npz")


def run(*words):
    return CliRunner().invoke(attributes_command, words)


def test_attributes_prints_every_measurement(file):
    lines = run(file).output.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(ATTRIBUTES)
    (row,) = json.loads(run(file, "--json").output)
    assert row["attributes"]["lanes_same"] == 2


def test_attributes_says_what_a_scene_misses(file, tmp_path):
    request = {"lanes_same": 2, "queue": True}
    (tmp_path / "asks.json").write_text(json.dumps({"asks": request}))
    for ask in (json.dumps(request), str(tmp_path / "asks.json")):
        assert "50 % of the request holds; queue is no" in run(file, "--ask", ask).output
    (row,) = json.loads(run(file, "--json", "--ask", json.dumps(request)).output)
    assert row["share"] == 0.5 and row["misses"] == {"queue": False}


@pytest.mark.parametrize(("ask", "message"), [("{", "is no JSON"), ('{"layouts": "T"}', "write 'layout'")])
def test_attributes_refuses_a_faulty_request(file, ask, message):
    result = run(file, "--ask", ask)
    assert result.exit_code == 1 and message in str(result.exception)
