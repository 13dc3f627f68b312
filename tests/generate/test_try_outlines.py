"""Trials of the shipped model's outlines: reproducible, as one would sample them, and what ships is from them."""

from __future__ import annotations

import dataclasses

import pytest

import scjax
from experiments.try_outlines import make_trials
from scjax.generate.try_outlines import try_outlines
from scjax.language.attributes.table import ATTRIBUTES, check_attributes
from tests.factories.few_programs import use_few_programs


@pytest.fixture(scope="module")
def model():
    return scjax.load()


@pytest.fixture(scope="module")
def trials(model):
    with pytest.MonkeyPatch.context() as patch:
        use_few_programs(patch)
        return try_outlines(model, [5, 77, 1234], 0)


def test_a_trial_depends_on_its_outline_and_number_only(model, trials, monkeypatch):
    use_few_programs(monkeypatch)
    assert try_outlines(model, [77], 0)[0].measured["vehicles"] == trials[1].measured["vehicles"]
    assert try_outlines(model, [5, 77, 1234], 1) != trials


def test_trials_show_the_numbers_of_their_outlines(model, trials):
    for row, trial in zip((5, 77, 1234), trials, strict=True):
        assert trial.measured.keys() == ATTRIBUTES.keys() and trial.faults >= 0
        own = model.outlines.measurements(row)
        assert [trial.measured[name] for name in ("pedestrians", "cyclists")] == [own["pedestrians"], own["cyclists"]]


def test_trials_that_were_made_are_not_made_again(model, trials, tmp_path, monkeypatch):
    rows = model.outlines.lanes[:3], model.outlines.agents[:3], model.outlines.domains[:3]
    few = dataclasses.replace(
        model.outlines,
        **dict(zip(("lanes", "agents", "domains"), rows, strict=True)),
        measured=model.outlines.measured[:3],
        ahead=None,
        trials=None,
    )
    small = dataclasses.replace(model, outlines=few)
    use_few_programs(monkeypatch)
    first = make_trials(small, 0, 0, tmp_path)
    monkeypatch.setattr("experiments.try_outlines.try_outlines", None)
    assert make_trials(small, 0, 0, tmp_path) == first
    with pytest.raises(ValueError, match="no outlines"):
        try_outlines(dataclasses.replace(model, outlines=None), [0], 0)


def test_the_model_that_ships_has_trials_of_all_outlines(model):
    trials, request = model.outlines.trials, check_attributes({"layout": "roundabout"})
    held = trials.mean_held(request, model.outlines.values)
    shows = model.outlines.count_held(request) == 1
    assert trials.measured.shape[:2] == (len(model.outlines), 3)
    assert held[shows].mean() > 0.5 > 0.1 > held[~shows].mean()
