"""Curves are what the runs wrote, whatever they were interrupted by."""

import json

import pytest

from experiments.plot_training import draw, main, read


def write(folder, lines):
    folder.mkdir(exist_ok=True)
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    return folder


def line(step, scope="train", **values):
    return {"step": step, "scope": scope, "time": 0.0, **values}


def test_a_repeated_step_counts_once_the_last_time(tmp_path):
    lines = [line(1, loss=5.0, kl=1.0), line(2, loss=9.0), line(2, loss=4.0), line(2, "val", error_m=0.5)]
    assert read(write(tmp_path / "run", lines)) == {"loss": [(1, 5.0), (2, 4.0)], "val error_m": [(2, 0.5)]}


def test_a_panel_a_number_and_a_line_a_run(tmp_path):
    runs = {
        name: read(write(tmp_path / name, [line(s, loss=10.0 / s / scale) for s in (1, 5, 9)]))
        for name, scale in (("short", 1), ("long", 2))
    }
    figure = draw(runs, tmp_path / "curves.png")
    (panel,) = figure.axes
    assert [drawn.get_label() for drawn in panel.lines] == ["short", "long"]
    assert panel.get_yscale() == "log"
    assert list(panel.lines[1].get_ydata()) == [5.0, 1.0, 10.0 / 18]
    assert (tmp_path / "curves.png").stat().st_size > 5_000
    assert not list(tmp_path.glob(".*.png"))


@pytest.mark.parametrize(("text", "message"), [("", "no metrics yet"), ("{\n", "line 1"), ('{"step": 1}\n', "scope")])
def test_files_that_are_no_metrics(tmp_path, text, message):
    (tmp_path / "metrics.jsonl").write_text(text)
    with pytest.raises(SystemExit, match=message):
        main([str(tmp_path), "--out", str(tmp_path / "x.png")])
    assert not (tmp_path / "x.png").exists()
