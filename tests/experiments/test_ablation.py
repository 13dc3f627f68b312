"""The ablation end to end on texts: results, resumption, and runs from elsewhere."""

from __future__ import annotations

import dataclasses
import json

import pytest

import scjax
from experiments.studies.ablation.judge import METRICS
from experiments.studies.ablation.run import ablate, check_bases, load_runs
from scjax.data.manifest import load_manifest
from tests.factories.ablations import save_inputs, smoke_config
from tests.factories.worlds import tiny_model

ELSEWHERE = [(1, "text", "full"), (0, "image", "full")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, captioned_records):
    return save_inputs(tmp_path_factory.mktemp("ablation"), captioned_records)


@pytest.fixture(scope="module")
def workdir(folder):
    """The work folder of an ablation of "none" and "full"."""
    config = smoke_config(folder)
    domains = tuple(load_manifest(folder / "records")["domains"])  # as many as the trained models have
    base = dataclasses.replace(tiny_model(domains=len(domains)), domains=domains, counts=None)
    config.base = str(scjax.save(base, folder / "base"))
    ablate(config, folder / "out", "the command")
    return folder / "out"


def read(workdir):
    return json.loads((workdir / "ablation.json").read_text())


def test_ablation_runs_all_entries(workdir):
    assert [run["entry"] for run in read(workdir)["runs"]] == ["none", "full"]
    assert not list(workdir.glob("runs/*/checkpoints"))


def test_entry_without_condition_ignores_shuffling(workdir):
    none, _ = read(workdir)["runs"]
    assert json.dumps(none["own"]) == json.dumps(none["shuffled"]) and none["parameters"] == 0


def test_entry_with_condition_adds_parameters_and_work(workdir):
    none, full = read(workdir)["runs"]
    assert full["parameters"] > 0 and full["flops"] > full["flops_cached"] > none["flops"] > 0
    assert full["seconds_per_step"] > 0


def test_entry_with_condition_depends_on_the_condition(workdir):
    _, full = read(workdir)["runs"]
    assert 0 <= full["own"]["prompt"] <= 1 and full["own"].keys() == METRICS.keys()
    assert json.dumps(full["own"]) != json.dumps(full["shuffled"])


def test_ablation_writes_page_and_picture(workdir):
    text = (workdir / "ablation.md").read_text()
    assert "| full | not judged: too few seeds" in text and "`the command`" in text
    assert (workdir / "ablation.png").stat().st_size > 5_000


def test_ablation_continues_without_training_again(folder, workdir):
    before = read(workdir)
    models = {path: path.stat().st_mtime_ns for path in workdir.glob("**/model/model.json")}
    assert len(models) == 2
    next((workdir / "runs").glob("text-none-*/result-*.json")).unlink()
    config = smoke_config(folder)
    config.base = str(folder / "base")
    ablate(config, workdir, "the command")
    assert models == {path: path.stat().st_mtime_ns for path in models}
    assert json.dumps(read(workdir)["runs"]) == json.dumps(before["runs"])


def test_load_runs_accepts_other_seeds_and_modalities(workdir):
    path, setting = workdir / "ablation.json", read(workdir)["setting"]
    assert [run["seed"] for run in load_runs(str(path), setting, ELSEWHERE)] == [0, 0]
    load_runs(str(path), {**setting, "requests": {"image": "not in both"}}, ELSEWHERE)


def test_load_runs_refuses_runs_of_this_ablation(workdir):
    path, setting = workdir / "ablation.json", read(workdir)["setting"]
    with pytest.raises(ValueError, match="has full on text of seed 0"):
        load_runs(str(path), setting, [*ELSEWHERE, (0, "text", "full")])


def test_load_runs_refuses_another_setting(workdir):
    path, setting = workdir / "ablation.json", read(workdir)["setting"]
    with pytest.raises(ValueError, match="another guidance, samples"):
        load_runs(str(path), {**setting, "guidance": 1.0, "samples": 1}, ELSEWHERE)


def test_load_runs_refuses_other_files(workdir):
    with pytest.raises(ValueError, match=r"ablation\.md is no ablation\.json"):
        load_runs(str(workdir / "ablation.md"), read(workdir)["setting"], ELSEWHERE)


def test_check_bases_allows_one_base_per_seed_and_modality():
    run = {"seed": 0, "modality": "text", "base": "a"}
    check_bases([run, {**run, "seed": 1, "base": "b"}, {**run, "modality": "image", "base": "b"}])
    with pytest.raises(ValueError, match="seed 0 on texts would have runs from two bases"):
        check_bases([run, {**run, "base": "b"}])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("entries", ("none", "ful"), "'ful' is unknown: choose of none, concat"),
        ("modalities", ("smell",), "'smell' is unknown: choose of text, image"),
        ("seeds", (), "name no run"),
    ],
)
def test_ablation_refuses_mistakes(folder, tmp_path, field, value, message):
    config = smoke_config(folder)
    config[field] = value
    with pytest.raises(ValueError, match=message):
        ablate(config, tmp_path)
