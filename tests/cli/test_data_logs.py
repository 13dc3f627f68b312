"""``scjax data logs``."""

from __future__ import annotations

import pytest

from scjax.cli.data import main
from scjax.scene import load_log
from scjax.towns import source
from tests.factories.town_traffic import write_fork_town


def test_data_logs_writes_logs_and_animations(tmp_path, capsys):
    assert main(["logs", str(tmp_path), "--worlds", "1", "--seed", "3", "--gif"]) == 0
    assert "3 logs of 1 worlds" in capsys.readouterr().out
    files = sorted(tmp_path.glob("*.npz"))
    assert len(files) == 3 and all(load_log(file).num_steps == 101 for file in files)
    assert all(file.with_suffix(".gif").stat().st_size > 1000 for file in files)


def test_data_logs_overwrites_only_if_told(tmp_path, capsys):
    assert main(["logs", str(tmp_path), "--worlds", "1"]) == 0
    assert main(["logs", str(tmp_path), "--worlds", "1"]) == 1
    assert "--force" in capsys.readouterr().err


def test_data_logs_names_unknown_events(tmp_path, capsys):
    assert main(["logs", str(tmp_path), "--events", "flood"]) == 1
    assert "unknown event 'flood'" in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.fixture
def fork_town(tmp_path, monkeypatch):
    """A simulated map of two logs, so that SUMO is not needed."""
    towns = write_fork_town(tmp_path)
    monkeypatch.setattr(source, "make_towns", lambda folder, names, **options: towns)


def test_data_logs_writes_logs_of_towns(fork_town, tmp_path, capsys):
    assert main(["logs", str(tmp_path / "logs"), "--maps", str(tmp_path), "-n", "1", "--gif"]) == 0
    assert "1 logs" in capsys.readouterr().out
    file = tmp_path / "logs" / "A-0-0001.npz"
    assert file.with_suffix(".gif").stat().st_size > 1000
    log = load_log(file)
    assert log.timestamps[[0, -1]].round(6).tolist() == [-2.0, 8.0] and log.num_steps == 101
    assert log.valid[log.ego_index].all() and len(log.lanes)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--maps", ".", "-n", "3"], "give 2 logs"),
        (["--maps", ".", "--worlds", "3"], "leave them out"),
        (["-n", "3"], "add --towns or --maps"),
    ],
)
def test_data_logs_refuses_counts_that_do_not_fit(fork_town, tmp_path, capsys, arguments, message):
    assert main(["logs", str(tmp_path / "logs"), *arguments]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
