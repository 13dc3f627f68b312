"""scjax simulate: from words or a file to a log and an animation."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scjax.cli import main
from scjax.scene import load_log, save_map
from tests.factories.road_maps import agent, crossing


def _run(*words: str) -> int:
    try:
        main(list(words))
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.fixture
def map_file(tmp_path):
    path = tmp_path / "map.npz"
    save_map(crossing([agent(30.0, 0.0, speed=8.0), agent(100.0, -40.0, 90.0, speed=9.0)]), path)
    return path


def test_a_map_becomes_an_animation_and_a_log(map_file, tmp_path, capsys):
    out = tmp_path / "new" / "clip.gif"
    assert _run("simulate", "--start", str(map_file), "--seconds", "1.5", "--out", str(out), "--json") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["files"] == [str(out), str(out.with_suffix(".npz"))] and summary["objects"] >= 2
    assert out.read_bytes()[:4] == b"GIF8"
    log = load_log(out.with_suffix(".npz"))
    assert log.num_steps == 16 and np.hypot(*(log.positions[0, -1] - log.positions[0, 0])[:2]) > 5.0


def test_the_ending_npz_writes_the_log_alone(map_file, tmp_path):
    out = tmp_path / "log.npz"
    words = ("simulate", "--start", str(map_file), "--seconds", "1", "--behavior", "constant-velocity")
    assert _run(*words, "--out", str(out)) == 0
    assert load_log(out).num_steps == 11 and not list(tmp_path.glob("*.gif"))


@pytest.mark.parametrize(
    "words, code, cure",
    [
        ((), 2, "give a PROMPT or --start FILE"),
        (("a road", "--start", "x.npz"), 2, "one of both"),
        (("a road", "--step", "3"), 2, "--step is for a recording"),
        (("a road", "--out", "clip.avi"), 2, ".mp4 or .gif"),
        (("--start", "nothing.npz"), 1, "nothing.npz"),
        (("--start", "nothing.npz", "--seconds", "0"), 2, "seconds"),
    ],
)
def test_bad_words_are_refused_with_a_cure(words, code, cure, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert _run("simulate", *words) == code
    assert cure in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_unknown_behavior_is_refused(map_file, tmp_path, capsys):
    assert _run("simulate", "--start", str(map_file), "--behavior", "fast", "--out", str(tmp_path / "a.npz")) == 1
    assert "behavior is 'fast'" in capsys.readouterr().err
