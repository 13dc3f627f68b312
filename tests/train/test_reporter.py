"""metrics.jsonl of runs that continue."""

from __future__ import annotations

import json

import pytest

from scjax.train.reporter import Reporter


def steps(folder):
    return [json.loads(line)["step"] for line in (folder / "metrics.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("cut", [b"", b'{"step": 11, "sco', b"\xff\n", b"[1]\n", b"\0\0\0"])
def test_reporter_reports_no_step_twice(tmp_path, cut):
    """Case 21: lines beyond the checkpoint are cut, also one that a kill left incomplete."""
    with Reporter(tmp_path, first_step=0, last_step=20, tensorboard=False) as reporter:
        for step in range(1, 11):
            reporter.scalars(step, {"loss": 1.0})
    with (tmp_path / "metrics.jsonl").open("ab") as file:
        file.write(cut)
    with Reporter(tmp_path, first_step=8, last_step=20, tensorboard=False) as reporter:
        for step in range(9, 13):
            reporter.scalars(step, {"loss": 1.0})
    assert steps(tmp_path) == list(range(1, 13))
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_reporter_of_a_run_that_begins_anew_cuts_everything(tmp_path):
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n')
    with Reporter(tmp_path, first_step=0, last_step=20, tensorboard=False):
        pass
    assert steps(tmp_path) == []


def test_reporter_quiet_leaves_the_file(tmp_path):
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n')
    with Reporter(tmp_path, first_step=0, last_step=20, tensorboard=False, quiet=True):
        pass
    assert steps(tmp_path) == [1]
