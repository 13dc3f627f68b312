"""Methods of a model: what it is asked for, how it samples, and what is generated only once."""

import dataclasses

import pytest

from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.evaluate.run import run_evaluation
from scjax.evaluate.sources import open_source
from scjax.scene.per_type import PerType
from tests.factories.evaluations import (
    SCENES,
    RoadModel,
    evaluate_tables,
    evaluation_config,
    read_report,
    save_batch,
)

SIZES = len(SCENES)
DRAWN = SIZES + 2  # more than there are references: these serve again


def of_model(name, request, **options):
    return {"name": name, "model": "m", "request": request, **options}


@pytest.fixture(scope="module")
def standard(worlds, tmp_path_factory):
    """The standard variant of a model: its functions, the tables and the report."""
    model, out = RoadModel(), tmp_path_factory.mktemp("standard")
    config = evaluation_config(worlds, "standard", model="m", num_scenes=DRAWN, compat=False, novelty=4)
    return model, evaluate_tables(config, out, model.functions), read_report(out)


def test_standard_variant_samples_with_and_without_counts(standard):
    conditions = standard[0].conditions
    assert len(conditions) == 2 * DRAWN
    assert sum(condition.num_agents is None for condition in conditions) == DRAWN


def test_standard_variant_fills_the_tables_of_a_model(standard):
    _, tables, report = standard
    reconstruction = tables["Reconstruction"]["rows"]["reconstruction"]
    assert reconstruction["numbers"]["lane_point_m"]["value"] == 0 and reconstruction["scenes"] == SIZES
    assert tables["Numbers of lanes and agents"]["rows"]["samples"]["numbers"]["agents mae"]["value"] == 0
    assert tables["Placement of agents"]["rows"]["samples"]["scenes"] == DRAWN
    assert "m: " in report["facts"]["models"]


def test_samples_are_generated_once_per_seed(worlds, tmp_path, road_model):
    methods = (of_model("samples", "counts"),)
    for seed, total in ((0, DRAWN), (0, DRAWN), (1, 2 * DRAWN)):
        config = evaluation_config(worlds, methods=methods, seed=seed, num_scenes=DRAWN, compat=False)
        run_evaluation(config, tmp_path / "out", road_model.functions)
        assert len(road_model.conditions) == total


def test_energy_guidance_is_passed_per_method(worlds, tmp_path, road_model):
    methods = (
        of_model("default", "counts"),
        of_model("with", "counts", energy_guidance=True),
        of_model("without", "none", energy_guidance=False),
    )
    run_evaluation(evaluation_config(worlds, methods=methods), tmp_path / "out", road_model.functions)
    assert [options.energy_guidance for options in road_model.options] == [None, True, False]


def test_temperature_of_the_config_gives_other_samples(worlds, tmp_path, road_model):
    for temperature in ((0.0, 0.0), (0.75, 0.5)):
        config = evaluation_config(worlds, methods=(of_model("samples", "counts"),), temperature=temperature)
        run_evaluation(config, tmp_path / "out", road_model.functions)
    assert [options.temperature for options in road_model.options] == [None, PerType(agents=0.75, lanes=0.5)]


def test_model_defaults_give_other_samples_of_equal_weights(worlds, tmp_path, road_model):
    config = evaluation_config(worlds, methods=(of_model("samples", "counts"),))
    run_evaluation(config, tmp_path / "out", road_model.functions)
    road_model.model = dataclasses.replace(road_model.model, energy_guidance=EnergyGuidance())
    for _ in range(2):
        run_evaluation(config, tmp_path / "out", road_model.functions)
    assert len(road_model.options) == 2


def test_best_of_is_passed_and_named_in_the_report(worlds, tmp_path, road_model):
    methods = (of_model("plain", "prompt+counts"), of_model("selected", "prompt", best_of=8))
    tables = evaluate_tables(evaluation_config(worlds, methods=methods), tmp_path / "out", road_model.functions)
    assert [options.best_of for options in road_model.options] == [1, 8]
    assert all(condition.prompt for condition in road_model.conditions)
    assert list(tables["Control"]["rows"]) == ["plain", "selected (best of 8, repaired)"]
    assert "do not measure the quality of a model" in read_report(tmp_path / "out")["facts"]["selection"]


def test_shards_share_the_generation(worlds, tmp_path, road_model):
    methods = (of_model("samples", "counts"), "copy")
    reports = []
    for shard in (0, 1, 0, 1):
        config = evaluation_config(worlds, methods=methods, shard=(shard, 2), part_size=SIZES // 2)
        reports.append(run_evaluation(config, tmp_path / "out", road_model.functions))
    assert reports[0] is None and reports[-1] is not None
    assert len(road_model.conditions) == SIZES
    assert read_report(tmp_path / "out")["tables"]["Placement of agents"]["rows"]["samples"]["scenes"] == SIZES


def test_placement_variant_keeps_the_lanes_of_references(worlds, tmp_path, road_model):
    config = evaluation_config(worlds, "placement", model="m")
    rows = evaluate_tables(config, tmp_path / "out", road_model.functions)["Faults of single scenes"]["rows"]
    random, real = (rows[name]["numbers"]["vehicles_on_lane"]["value"] for name in ("random on lanes", "copy"))
    assert real < random  # below 1, since egos stay where they are
    assert any(c.known is not None and len(c.known.lane_mask) for c in road_model.conditions)


@pytest.fixture(scope="module")
def prompts(worlds, tmp_path_factory):
    """Conditions of the four methods of the variant "prompts", and the tables."""
    road_model, out = RoadModel(), tmp_path_factory.mktemp("prompts")
    tables = evaluate_tables(evaluation_config(worlds, "prompts", model="m"), out, road_model.functions)
    return [road_model.conditions[k : k + SIZES] for k in range(0, 4 * SIZES, SIZES)], tables


def test_prompts_variant_asks_with_prompts_and_counts(prompts, worlds):
    (prompt, with_counts, shuffled, silent), _ = prompts
    assert all(condition.num_lanes is None and condition.prompt for condition in prompt)
    texts = [condition.prompt for condition in prompt]
    assert [condition.prompt for condition in with_counts] == texts
    assert [condition.prompt for condition in shuffled] == [*texts[1:], texts[0]]
    assert all(condition.prompt is None for condition in silent)
    sizes = [(len(one.lane_mask), len(one.agent_mask)) for one in open_source(f"npz:{worlds}").read(range(SIZES))]
    for conditions in (with_counts, shuffled, silent):
        assert [(condition.num_lanes, condition.num_agents) for condition in conditions] == sizes


def test_prompts_variant_reports_gains(prompts):
    assert set(prompts[1]["Gains in control"]["rows"]) == {
        "prompt, true counts over shuffled prompt, true counts",
        "prompt, true counts over nearest caption + counts",
        "prompt over nearest caption",
    }


def test_shuffled_prompts_need_two_locations(worlds, tmp_path, road_model):
    methods = (of_model("one", "shuffled_prompt+counts"),)
    config = evaluation_config(worlds, reference=f"npz:{worlds}/b0.npz", methods=methods)
    with pytest.raises(ValueError, match="all references lie at"):
        run_evaluation(config, tmp_path / "out", road_model.functions)


@pytest.mark.parametrize("variant", ["controllability", "mechanisms", "collisions", "generalization"])
def test_variants_of_the_paper_have_all_rows(variant, worlds, tmp_path, road_model):
    config = evaluation_config(worlds, variant, model="m", compat=False)
    generated = str(save_batch(tmp_path / "generated"))
    config.folders.update(dict.fromkeys(config.folders, generated))
    names = {entry if isinstance(entry, str) else entry["name"] for entry in config.methods}
    tables = evaluate_tables(config, tmp_path / "out", road_model.functions)
    assert set(tables["Control"]["rows"]) == names
    assert set(tables["Faults of single scenes"]["rows"]) == names | {"real"}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"methods": ({"name": "a", "source": "npz:{image}"},)}, "{image} has no folder: give --config.folders.image"),
        ({"methods": (of_model("a", "counts") | {"model": "{model}"},)}, "{model} has no folder: give --config.model"),
        ({"methods": ("copy",), "temperature": (0.5, 0.0)}, "two numbers above 0"),
        ({"more": "name=a, source=npz:WORLDS, pairing=in_order", "num_scenes": 3}, "'a': 8 scenes but 3 references"),
        ({"methods": ("chance",), "retrieval_set": ""}, "name one with --config.retrieval_set"),
        ({"methods": ("copy",), "gains": (("copy",),)}, "gain .*: give two methods that answer the same references"),
        ({"methods": ("copy",), "more": "name=copy, source=npz:WORLDS"}, "methods need unique names"),
        ({"methods": ()}, "there is nothing to compare"),
    ],
)
def test_run_evaluation_names_mistakes(worlds, tmp_path, fields, message, road_model):
    fields = {key: value.replace("WORLDS", str(worlds)) if key == "more" else value for key, value in fields.items()}
    with pytest.raises(ValueError, match=message):
        run_evaluation(evaluation_config(worlds, **fields), tmp_path / "out", road_model.functions)
