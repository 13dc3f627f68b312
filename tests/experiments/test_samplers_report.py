"""The report of the samplers study on made-up rows: which metrics are worse, the verdict, the page."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from experiments.studies.samplers_report import METRICS, draw, markdown, verdict, worse_metrics


def make_rows(spread=0.1):
    """A reference of 1 in everything, and a setting of 10 evaluations; bootstrap samples that share locations."""
    rng = np.random.default_rng(0)
    metrics = {name: {"value": 1.0, "low": 0.8, "high": 1.2} for name in METRICS}
    reference = {"name": "ddpm 100", "series": "ddpm", "evaluations": 100, "seconds": 1.0, "metrics": metrics}
    reference["bootstrap"] = {name: 1 + 5 * spread * rng.normal(size=300) for name in METRICS}
    setting = {**copy.deepcopy(reference), "name": "dpm++ 10", "series": "dpm++", "evaluations": 10}
    for column in setting["bootstrap"].values():
        column += spread * rng.normal(size=300)
    return reference, setting


def test_equal_rows_are_not_worse():
    reference, setting = make_rows()
    assert worse_metrics(setting, reference) == [] == worse_metrics(reference, reference)


def test_worse_metrics_allow_for_the_number_of_metrics():
    reference, setting = make_rows()
    changes = {"open_connections": 0.4, "off_heading": 0.2, "vehicles_on_lane": 0.4, "connection_gap_m": -0.4}
    for name, change in changes.items():  # more vehicles on lanes and smaller gaps are better
        setting["metrics"][name]["value"] += change
    assert worse_metrics(setting, reference) == ["open_connections"]  # two deviations are chance among sixteen


def test_worse_metrics_count_nan_as_worse():
    reference, setting = make_rows()
    setting["metrics"]["vehicles_on_lane"]["value"] = float("nan")
    assert "vehicles_on_lane" in (worse_metrics(setting, reference) or [])


def test_worse_metrics_of_constant_differences():
    reference, setting = make_rows()
    setting["metrics"]["off_heading"]["value"] += 0.2
    constant = {**copy.deepcopy(reference), "metrics": setting["metrics"]}
    assert "off_heading" in (worse_metrics(constant, reference) or [])


def test_worse_metrics_need_bootstrap_samples():
    reference, setting = make_rows()
    assert worse_metrics({**setting, "bootstrap": {}}, reference) is None


def test_chance_worsens_something_in_one_sweep_of_twenty():
    rng, sweeps = np.random.default_rng(1), 0
    for _ in range(200):
        reference, setting = make_rows()
        for name in METRICS:
            setting["metrics"][name]["value"] += 0.1 * rng.normal()
        sweeps += bool(worse_metrics(setting, reference))
    assert 2 <= sweeps <= 20


@pytest.fixture
def sweep():
    """Reference, and dpm++ with 10, 6 and 4 steps; the last worsens prompts."""
    reference, ten = make_rows()
    six, four = copy.deepcopy(ten), copy.deepcopy(ten)
    six |= {"name": "dpm++ 6", "evaluations": 6}
    four |= {"name": "dpm++ 4", "evaluations": 4}
    four["metrics"]["prompt"]["value"] = 0.2
    return [reference, ten, six, four]


def test_verdict_names_the_cheapest_without_a_difference(sweep):
    expected = "Fewest steps without a significant difference from ddpm 100: dpm++ 6 (6 evaluations"
    assert verdict(sweep, sweep[0]).startswith(expected)


def test_verdict_rejects_steps_whose_series_is_worse_with_more(sweep):
    sweep[1]["metrics"]["prompt"]["value"] = 0.2
    assert verdict(sweep, sweep[0]).startswith("All settings differ significantly from ddpm 100")


def test_verdict_names_the_nearest_where_all_differ(sweep):
    text = verdict([sweep[0], sweep[3]], sweep[0])
    assert "dpm++ 4 (4" in text and "what the prompt asks for" in text


def test_verdict_needs_a_second_setting(sweep):
    assert verdict(sweep[:1], sweep[0]).startswith("Nothing to compare")


def test_verdict_counts_what_repeats_worsen(sweep):
    _, _, six, four = sweep
    repeats = [{**four, "name": "ddpm 100, repeat 1", "repeat": 1}, {**six, "name": "ddpm 100, repeat 2", "repeat": 2}]
    assert verdict([*sweep, *repeats], sweep[0]).endswith(
        "s). With other random numbers ddpm 100 is worse in 1, 0 of 16."
    )


def test_page_names_worse_metrics(sweep):
    text = markdown(sweep, sweep[0], "the command", "the verdict")
    assert "| dpm++ 4 | 4 | 1 | what the prompt asks for |" in text
    assert "| dpm++ 6 | 6 | 1 | no significant difference |" in text


def test_picture_has_a_panel_per_metric_and_one_of_seconds(sweep):
    assert len([panel for panel in draw(sweep, sweep[0]).axes if panel.get_title()]) == len(METRICS) + 1
