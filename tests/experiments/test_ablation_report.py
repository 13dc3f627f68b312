"""The report of an ablation on made-up runs: spreads, gains, verdicts, windows, guidance."""

from __future__ import annotations

import json
import math

import pytest

from experiments.studies.ablation import guidance
from experiments.studies.ablation.judge import METRICS
from experiments.studies.ablation.report import (
    Spread,
    markdown,
    over_none,
    over_shuffled,
    summary,
    verdict,
    window_hypothesis,
)


def make_run(entry: str, seed: int, own: float, shuffled: float) -> dict:
    """A made-up run whose every metric is ``own``."""
    return {
        "modality": "text",
        "entry": entry,
        "seed": seed,
        "own": dict.fromkeys(METRICS, own),
        "shuffled": dict.fromkeys(METRICS, shuffled),
        "parameters": 10,
        "flops": 2e6,
        "flops_cached": 1e6,
        "seconds_per_step": 0.1,
        "seconds_per_scene": math.nan,
    }


def make_runs(entry: str, gain: float, deviation: float = 0.01) -> list[dict]:
    """Three seeds whose metrics with shuffled conditions are 0.5."""
    return [make_run(entry, seed, 0.5 + gain + deviation * (seed - 1), 0.5) for seed in range(3)]


NONE = [make_run("none", seed, 0.5, 0.5) for seed in range(3)]


def with_lower_loss(runs: list[dict]) -> list[dict]:
    return [{**run, "own": {**run["own"], "loss": 0.4 + 0.001 * run["seed"]}} for run in runs]


def test_spread_is_students_interval():
    spread = Spread.of([1.0, 2.0, 3.0, math.nan])
    assert spread.mean == 2 and spread.half == pytest.approx(4.303 / math.sqrt(3), abs=1e-3)


def test_spread_of_few_seeds_has_no_interval():
    assert math.isnan(Spread.of([1.0]).half) and Spread.of([1.0]).format() == "1.000" and Spread.of([]).format() == ""


def test_over_none_compares_equal_seeds():
    none = [make_run("none", seed, 0.1 * seed, 0.1 * seed) for seed in range(3)]
    better = [make_run("full", seed, 0.1 * seed + 0.2, 0.1 * seed) for seed in range(3)]
    gain = over_none(none + better, "text", "full", "prompt")
    assert gain.mean == pytest.approx(0.2) and gain.half == pytest.approx(0, abs=1e-9)  # common differences cancel


def test_over_shuffled_is_signed():
    better = [make_run("full", seed, 0.3, 0.1) for seed in range(3)]
    assert over_shuffled(better, "text", "full", "vehicles_overlapping").mean == pytest.approx(-0.2)  # less is better


def test_verdict_needs_both_gains_beyond_their_intervals():
    assert verdict(NONE + make_runs("full", 0.1), "text", "full") == "follows its condition"
    weak = NONE + make_runs("full", 0.01)
    assert verdict(weak, "text", "full") == "no significant gain over shuffled or none"
    high = [make_run("none", seed, 0.7, 0.7) for seed in range(3)]
    assert verdict(high + make_runs("full", 0.1), "text", "full") == "no significant gain over none"


def test_verdict_needs_several_seeds():
    runs = NONE[:1] + make_runs("full", 0.1)[:1]
    assert verdict(runs, "text", "full").startswith("not judged: too few seeds")


def test_verdict_names_a_lower_loss():
    weak = make_runs("full", 0.01)
    text = verdict(NONE + with_lower_loss(weak), "text", "full")
    assert text == "no significant gain over shuffled or none, though its loss is lower"
    runs = with_lower_loss(NONE) + with_lower_loss(weak)
    assert verdict(runs, "text", "full") == "no significant gain over shuffled or none"


def test_page_has_a_row_per_entry():
    table = markdown(NONE + make_runs("full", 0.1), "the command")
    assert "| full | follows its condition | 0.100 ± 0.025 |" in table and "nan" not in table
    verdicts = [row["verdict"] for row in summary(NONE + make_runs("full", 0.1))]
    assert verdicts == ["reference", "follows its condition"]


def test_page_has_gains_of_the_loss_with_more_digits():
    table = markdown(NONE + with_lower_loss(make_runs("full", 0.01)), "the command")
    row = next(line for line in table.splitlines() if line.startswith("| full"))
    assert row.count("| 0.0990 ± 0.0025 |") == 1  # below shuffled, followed by the same below none


def test_window_hypothesis_has_three_outcomes():
    base = make_runs("windowed", 0.1) + make_runs("windowed_ends", 0.1) + make_runs("padded", 0.1)
    assert "Seen here" in window_hypothesis(base + make_runs("windowed_padded", 0.0))
    assert "Not seen here" in window_hypothesis(base + make_runs("windowed_padded", 0.1))
    no_gain = [run for run in base if run["entry"] != "padded"] + make_runs("padded", 0.0)
    assert "Inconclusive" in window_hypothesis(no_gain + make_runs("windowed_padded", 0.0))


def test_window_hypothesis_needs_all_rows():
    assert window_hypothesis(make_runs("windowed", 0.1)) == ""


@pytest.fixture
def reports(tmp_path):
    """ablation.json files at guidance 4 and 1."""
    paths = []
    for scale in (4.0, 1.0):
        runs = make_runs("cross_global", 0.05 * scale, 0.0) + make_runs("frozen", 0.02 * scale, 0.0)
        paths.append(tmp_path / f"{scale}.json")
        paths[-1].write_text(json.dumps({"setting": {"guidance": scale, "samples": 3}, "runs": runs}))
    return paths


def test_guidance_reads_curves_of_several_reports(reports):
    curves = guidance.read(reports)
    assert list(curves) == ["cross-global", "cross-global, base frozen"] and list(curves["cross-global"]) == [1, 4]
    assert curves["cross-global"][4]["prompt"]["own"].mean == pytest.approx(0.7)


def test_guidance_writes_page_and_picture(reports, tmp_path):
    guidance.main([*map(str, reports), f"--out={tmp_path / 'page'}"])
    assert (tmp_path / "page.png").stat().st_size > 5_000
    assert "| cross-global, base frozen | 4 | 0.080 ± 0.000 | 0.580 ± 0.000 |" in (tmp_path / "page.md").read_text()


def test_guidance_refuses_a_repeated_scale(reports):
    with pytest.raises(SystemExit, match="both have guidance 4"):
        guidance.main([str(reports[0]), str(reports[0])])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"setting": {"guidance": 1.0, "samples": 4}, "runs": []}, "another samples than"),
        ({}, r"not what experiments\.studies\.ablation writes"),
    ],
)
def test_guidance_refuses_other_files(reports, content, message):
    reports[1].write_text(json.dumps(content))
    with pytest.raises(SystemExit, match=message):
        guidance.main([*map(str, reports)])
