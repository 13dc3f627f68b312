"""Entries and run configs of the ablation: what differs between runs."""

from __future__ import annotations

import pytest

from experiments.studies.ablation.config import get_config
from experiments.studies.ablation.entries import ENTRIES, MECHANISMS, RECIPES, select_entries
from experiments.studies.ablation.run import run_config
from scjax.nn.cross_attention import OPTIONS, ContextSpec, from_name


@pytest.fixture
def config():
    config = get_config("smoke")
    config.records, config.autoencoder = "records", "autoencoder"
    return config


def test_runs_differ_in_the_mechanism_only(config):
    one, other = (run_config(config, "base", ENTRIES[name], "text", 2).to_dict() for name in ("full", "linear"))
    assert {field for field in one if one[field] != other[field]} == {"cross_attention"}


def test_runs_take_seed_and_crop(config):
    runs = [run_config(config, "base", ENTRIES["full"], "image", seed) for seed in (0, 1)]
    assert [run.batch.seed for run in runs] == [run.seed for run in runs] == [0, 1]
    assert runs[0].batch.crops == (0.0, 0.0, 1.0)


def test_run_config_leaves_the_ablation_config_unchanged(config):
    window = run_config(config, "base", ENTRIES["windowed_padded"], "text", 0)
    assert window.cross_attention_options.windowed.alignment == "fa2" and window.model.attend_padding
    assert config.training.seed == 0 and config.training.cross_attention_options.windowed.window == 0


def test_recipes_differ_in_dropout_or_in_what_is_trained(config):
    runs = {name: run_config(config, "base", entry, "text", 0).to_dict() for name, entry in RECIPES.items()}
    dropout = {name: fields["loss"].pop("condition_dropout") for name, fields in runs.items()}
    assert dropout == {
        "undropped": 0.0,
        "cross_global": 0.1,
        "frozen": 0.1,
        "dropped_quarter": 0.25,
        "dropped_half": 0.5,
    }
    assert [name for name, fields in runs.items() if fields.pop("freeze")] == ["frozen"]
    assert all(fields == runs["cross_global"] for fields in runs.values())


def test_variants_have_their_entries():
    assert get_config("recipe").entries == tuple(RECIPES) and get_config().entries == tuple(MECHANISMS)
    with pytest.raises(ValueError, match="unknown variant"):
        get_config("huge")


def work_of(modality):
    """Multiply-adds of every entry of a modality."""
    image = ContextSpec(kind="image", grid=(14, 14), modalities=2)
    spec, tokens = (ContextSpec(kind="text"), 40) if modality == "text" else (image, 392)
    options = {
        name: from_name(ENTRIES[name].cross_attention, **ENTRIES[name].options_of(modality))
        for name in select_entries(tuple(ENTRIES), modality)
    }
    return {name: one.work(128, 4, spec, 26, tokens) for name, one in options.items()}


@pytest.mark.parametrize("modality", ["text", "image"])
def test_entries_cover_all_mechanisms_with_valid_options(modality):
    names = select_entries(tuple(ENTRIES), modality)
    assert names[0] == "none" and {ENTRIES[name].cross_attention for name in names} == set(OPTIONS)
    work = work_of(modality)
    assert work["windowed"].attend < work["full"].attend


def test_text_windows_hold_a_third_of_the_keys():
    work = work_of("text")
    projections = 2 * 26 * 128 * 128
    share = (work["windowed"].attend - projections) / (work["full"].attend - projections)
    assert 0.25 < share < 0.4


def test_matched_entry_has_twice_the_encoding_work():
    work = work_of("text")
    assert work["matched"].encode == 2 * work["full"].encode
