"""``scjax data logs``."""

from __future__ import annotations

from scjax.cli.data import main
from scjax.scene import load_log


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
