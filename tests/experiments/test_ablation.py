"""The ablation end to end on texts, going on where it was; what it says of made-up runs; what it refuses."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

import scjax
from experiments.studies.ablation import guidance
from experiments.studies.ablation.config import get_config
from experiments.studies.ablation.denoising import denoising_losses
from experiments.studies.ablation.entries import ENTRIES, MECHANISMS, RECIPES, chosen
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
from experiments.studies.ablation.requests import padded, requests_of
from experiments.studies.ablation.run import ablate, check_bases, run_config, runs_of
from scjax.camera.raycast import CLASSES, GRID, render
from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.caption_features import embed_captions
from scjax.data.captions import add_captions
from scjax.models.denoiser.config import ImageCondition
from scjax.nn.cross_attention import OPTIONS, ContextSpec, from_name
from scjax.scene import Crop
from scjax.synthetic.source import Worlds
from tests.factories.words import Words
from tests.factories.worlds import AUTOENCODER, DENOISER, tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Captioned records of two held-back locations or more, and an autoencoder."""
    folder = tmp_path_factory.mktemp("ablate")
    build_records(Worlds(3, 6), folder / "records", BuildOptions(split_percent=40.0))
    add_captions(folder / "records", paraphrases=1, progress=False)
    embed_captions(folder / "records", Words(), progress=False)
    assert AUTOENCODER.lane_latent == DENOISER.lane_latent
    scjax.save(tiny_model().without("denoiser"), folder / "autoencoder")
    return folder


def configured(folder):
    config = get_config("smoke")
    config.records, config.autoencoder = str(folder / "records"), str(folder / "autoencoder")
    config.training.optimizer.learning_rate, config.training.ema_decay = 0.05, 0.5  # three steps leave a trace
    sizes = dataclasses.asdict(DENOISER)
    config.training.model.update({name: sizes[name] for name in ("lane_width", "agent_width", "lane_heads", "blocks")})
    return config


def test_two_mechanisms_end_to_end_go_on_where_they_were(folder, tmp_path):
    config = configured(folder)
    config.base = str(scjax.save(tiny_model(), tmp_path / "base"))
    report = ablate(config, tmp_path)
    content = json.loads((tmp_path / "ablation.json").read_text())
    none, full = content["runs"]
    assert [run["entry"] for run in content["runs"]] == ["none", "full"]
    assert json.dumps(none["own"]) == json.dumps(none["shuffled"]) and none["parameters"] == 0
    assert full["parameters"] > 0 and full["flops"] > full["flops_cached"] > none["flops"] > 0
    assert 0 <= full["own"]["prompt"] <= 1 and full["own"].keys() == METRICS.keys()
    assert json.dumps(full["own"]) != json.dumps(full["shuffled"]) and full["seconds_a_step"] > 0
    assert "| full | not judged: too few seeds" in report.read_text()
    assert (tmp_path / "ablation.png").stat().st_size > 5_000
    assert not list(tmp_path.glob("runs/*/checkpoints"))

    models = {path: path.stat().st_mtime_ns for path in tmp_path.glob("**/model/model.json")}
    assert len(models) == 2
    next((tmp_path / "runs").glob("text-full-*/result-*.json")).unlink()
    ablate(config, tmp_path)
    assert models == {path: path.stat().st_mtime_ns for path in models}
    again = json.loads((tmp_path / "ablation.json").read_text())
    assert json.dumps(again["runs"]) == json.dumps(content["runs"])

    # The runs of another seed or kind, made elsewhere, join the report.
    path, setting = tmp_path / "ablation.json", again["setting"]
    elsewhere = [(1, "text", "full"), (0, "image", "full")]
    assert [run["seed"] for run in runs_of(str(path), setting, elsewhere)] == [0, 0]
    with pytest.raises(ValueError, match="has full on text of seed 0"):
        runs_of(str(path), setting, [*elsewhere, (0, "text", "full")])
    with pytest.raises(ValueError, match="another guidance, samples"):
        runs_of(str(path), {**setting, "guidance": 1.0, "samples": 1}, elsewhere)
    runs_of(str(path), {**setting, "asked": {"image": "not asked there"}}, elsewhere)
    other = {"seed": 1, "kind": "text", "base": "of another machine"}
    check_bases([*again["runs"], other, {**other, "seed": 0, "kind": "image"}])
    with pytest.raises(ValueError, match=r"seed 0 on texts would have runs from two bases"):
        check_bases([*again["runs"], {**other, "seed": 0}])
    with pytest.raises(ValueError, match=r"report\.md is no ablation\.json"):
        runs_of(str(report.rename(tmp_path / "report.md")), setting, elsewhere)


def test_mechanisms_differ_in_nothing_but_themselves(folder):
    config = configured(folder)
    one, other = (run_config(config, "base", ENTRIES[name], "text", 2).to_dict() for name in ("full", "linear"))
    assert {field for field in one if one[field] != other[field]} == {"cross_attention"}
    seeds = [run_config(config, "base", ENTRIES["full"], "image", seed) for seed in (0, 1)]
    assert [made.batch.seed for made in seeds] == [made.seed for made in seeds] == [0, 1]
    assert seeds[0].batch.crops == (0.0, 0.0, 1.0)
    assert config.training.seed == 0 and config.training.cross_attention_options.windowed.window == 0  # left as it was
    window = run_config(config, "base", ENTRIES["windowed_padded"], "text", 0)
    assert window.cross_attention_options.windowed.alignment == "fa2" and window.model.attend_padding


def test_recipes_differ_in_the_share_dropped_or_in_what_is_trained(folder):
    config = configured(folder)
    made = {name: run_config(config, "base", entry, "text", 0).to_dict() for name, entry in RECIPES.items()}
    dropped = {name: fields["loss"].pop("condition_dropout") for name, fields in made.items()}
    assert dropped == {
        "undropped": 0.0,
        "cross_global": 0.1,
        "frozen": 0.1,
        "dropped_quarter": 0.25,
        "dropped_half": 0.5,
    }
    assert [name for name, fields in made.items() if fields.pop("freeze")] == ["frozen"]
    assert all(fields == made["cross_global"] for fields in made.values())
    assert get_config("recipe").entries == tuple(RECIPES) and get_config().entries == tuple(MECHANISMS)


@pytest.mark.parametrize("kind", ["text", "image"])
def test_every_entry_has_options_that_its_mechanism_takes(kind):
    """All ten are there; on 40 tokens of text a window reads a third, probes a quarter of the keys."""
    names = chosen(tuple(ENTRIES), kind)
    assert names[0] == "none" and {ENTRIES[name].cross_attention for name in names} == set(OPTIONS)
    crop = ContextSpec(kind="text") if kind == "text" else ContextSpec(kind="image", grid=(14, 14), modalities=2)
    work = {}
    for name in names:
        options = from_name(ENTRIES[name].cross_attention, **ENTRIES[name].options_of(kind))
        work[name] = options.work(128, 4, crop, 26, 40 if kind == "text" else 392)
    assert work["windowed"].attend < work["full"].attend
    if kind == "text":
        projections = 2 * 26 * 128 * 128
        share = (work["windowed"].attend - projections) / (work["full"].attend - projections)
        assert 0.25 < share < 0.4
        assert work["matched"].encode == 2 * work["full"].encode


def test_scenes_larger_than_those_trained_on_are_passed_over(folder):
    def ask(lanes):
        return requests_of("text", str(folder / "records"), 99, tiny_model(), (61, lanes))

    every = ask(100)
    lanes = sorted(int(scene.num_lanes) for scene in every.references)
    small = ask(lanes[-1] - 1)
    assert max(int(scene.num_lanes) for scene in small.references) < lanes[-1]
    assert len(small.references) == sum(number < lanes[-1] for number in lanes) < len(every.references)
    assert len(small.own) == len(small.shuffled) == len(small.asked) == len(small.clusters) == len(small.references)
    with pytest.raises(ValueError, match=r"none of .* has at most"):
        ask(0)


def test_image_requests_are_of_forward_windows_with_another_scenes_image(folder):
    requests = requests_of("image", str(folder / "records"), 4, tiny_model())
    for scene, own, shuffled in zip(requests.references, requests.own, requests.shuffled, strict=True):
        assert own.crop == Crop.FORWARD and int(scene.crop) == Crop.FORWARD
        np.testing.assert_array_equal(own.streams["image"].grid(), render(scene).image)
        assert (own.num_lanes, own.num_agents, own.domain) == (shuffled.num_lanes, shuffled.num_agents, shuffled.domain)
        assert not np.array_equal(own.streams["image"].tokens, shuffled.streams["image"].tokens)
    assert not requests.asked and requests.context == 392


def test_padded_texts_keep_their_tokens():
    tokens = np.ones((3, 5), np.float32)
    (cond,) = padded([scjax.Condition(streams={"text": scjax.Stream(tokens)})], 8)
    text = cond.streams["text"]
    assert text.tokens.shape == (8, 5) and text.mask.sum() == 3
    np.testing.assert_array_equal(text.tokens[:3], tokens)
    assert not text.tokens[3:].any()


def test_losses_differ_by_the_condition_alone(folder):
    model = tiny_model()
    requests = requests_of("image", str(folder / "records"), 5, model)
    scenes, plain = requests.references, [dataclasses.replace(cond, streams={}) for cond in requests.own]
    losses = denoising_losses(model, scenes, plain, 3)
    assert losses.shape == (len(scenes),) and (losses > 0).all() and len(set(losses)) == len(scenes)
    np.testing.assert_allclose(denoising_losses(model, scenes[:1], plain[:1], 3), losses[:1], rtol=1e-5)
    assert not np.isclose(denoising_losses(model, scenes[:1], plain[:1], 4), losses[:1]).any()

    reader = tiny_model(condition=ImageCondition(len(CLASSES), GRID, patch=1))
    own, other = (denoising_losses(reader, scenes, told, 3) for told in (requests.own, requests.shuffled))
    assert (own != other).all()


def run(entry: str, seed: int, own: float, shuffled: float) -> dict:
    """A made-up run whose every metric is ``own``."""
    return {
        "kind": "text",
        "entry": entry,
        "seed": seed,
        "own": dict.fromkeys(METRICS, own),
        "shuffled": dict.fromkeys(METRICS, shuffled),
        "parameters": 10,
        "flops": 2e6,
        "flops_cached": 1e6,
        "seconds_a_step": 0.1,
        "seconds_a_scene": math.nan,
    }


def runs(entry: str, gain: float, wobble: float = 0.01) -> list[dict]:
    """Three seeds whose twins are 0.5."""
    return [run(entry, seed, 0.5 + gain + wobble * (seed - 1), 0.5) for seed in range(3)]


def test_spreads_are_students_intervals():
    spread = Spread.of([1.0, 2.0, 3.0, math.nan])
    assert spread.mean == 2 and spread.half == pytest.approx(4.303 / math.sqrt(3), abs=1e-3)
    assert math.isnan(Spread.of([1.0]).half) and Spread.of([1.0]).told() == "1.000" and Spread.of([]).told() == ""


def test_gains_are_by_seed_and_signed():
    none = [run("none", seed, 0.1 * seed, 0.1 * seed) for seed in range(3)]
    better = [run("full", seed, 0.1 * seed + 0.2, 0.1 * seed) for seed in range(3)]
    gain = over_none(none + better, "text", "full", "prompt")
    assert gain.mean == pytest.approx(0.2) and gain.half == pytest.approx(0, abs=1e-9)  # what seeds share cancels
    assert over_shuffled(better, "text", "full", "vehicles_overlapping").mean == pytest.approx(-0.2)  # less is better


def test_a_verdict_needs_both_gains_beyond_their_intervals():
    none = [run("none", seed, 0.5, 0.5) for seed in range(3)]
    assert verdict(none + runs("full", 0.1), "text", "full") == "follows its condition"
    assert verdict(none + runs("full", 0.01), "text", "full") == "failed: not above its twin or none"
    high = [run("none", seed, 0.7, 0.7) for seed in range(3)]
    assert verdict(high + runs("full", 0.1), "text", "full") == "failed: not above none"
    assert verdict(none[:1] + runs("full", 0.1)[:1], "text", "full").startswith("not judged: too few seeds")
    table = markdown(none + runs("full", 0.1))
    assert "| full | follows its condition | 0.100 ± 0.025 |" in table and "nan" not in table
    assert [row["verdict"] for row in summary(none + runs("full", 0.1))] == ["reference", "follows its condition"]


def test_a_condition_that_is_read_but_not_followed_is_told_from_one_that_is_not_read():
    def losing(made: list[dict]) -> list[dict]:
        return [{**one, "own": {**one["own"], "loss": 0.4 + 0.001 * one["seed"]}} for one in made]

    none = [run("none", seed, 0.5, 0.5) for seed in range(3)]
    weak = runs("full", 0.01)
    assert (
        verdict(none + losing(weak), "text", "full") == "failed: not above its twin or none, though its loss is lower"
    )
    assert verdict(losing(none) + losing(weak), "text", "full") == "failed: not above its twin or none"
    row = next(line for line in markdown(none + losing(weak)).splitlines() if line.startswith("| full"))
    assert row.count("| 0.0990 ± 0.0025 |") == 1  # under its twin's, and the same under none's after it


def test_the_window_hypothesis_is_told_from_its_four_rows():
    base = runs("windowed", 0.1) + runs("windowed_ends", 0.1) + runs("padded", 0.1)
    assert "Seen here" in window_hypothesis(base + runs("windowed_padded", 0.0))
    assert "Not seen here" in window_hypothesis(base + runs("windowed_padded", 0.1))
    alone = runs("windowed", 0.1) + runs("windowed_ends", 0.1) + runs("padded", 0.0) + runs("windowed_padded", 0.0)
    assert "Open" in window_hypothesis(alone) and window_hypothesis(base) == ""


def test_mistakes_are_told(folder, tmp_path):
    config = configured(folder)
    config.entries = ("none", "ful")
    with pytest.raises(ValueError, match="'ful' is unknown: choose of none, concat"):
        ablate(config, tmp_path)
    config.entries, config.kinds = ("none",), ("smell",)
    with pytest.raises(ValueError, match="no kind of condition: choose of text, image"):
        ablate(config, tmp_path)
    with pytest.raises(ValueError, match="unknown variant"):
        get_config("huge")


def test_guidance_curves_are_the_rows_of_several_reports(tmp_path):
    paths = []
    for weight in (4.0, 1.0):
        made = runs("cross_global", 0.05 * weight, 0.0) + runs("frozen", 0.02 * weight, 0.0)
        paths.append(tmp_path / f"{weight}.json")
        paths[-1].write_text(json.dumps({"setting": {"guidance": weight, "samples": 3}, "runs": made}))
    curves = guidance.read(paths)
    assert list(curves) == ["cross-global", "cross-global, base frozen"] and list(curves["cross-global"]) == [1, 4]
    assert curves["cross-global"][4]["prompt"]["own"].mean == pytest.approx(0.7)
    guidance.main([*map(str, paths), "--out", str(tmp_path / "a.png")])
    assert (tmp_path / "a.png").stat().st_size > 5_000
    table = (tmp_path / "a.md").read_text()
    assert "| cross-global, base frozen | 4 | 0.080 ± 0.000 | 0.580 ± 0.000 |" in table

    with pytest.raises(SystemExit, match="both of weight 4"):
        guidance.main([str(paths[0]), str(paths[0])])
    paths[1].write_text(json.dumps({"setting": {"guidance": 1.0, "samples": 4}, "runs": []}))
    with pytest.raises(SystemExit, match="another samples than"):
        guidance.main([*map(str, paths)])
    paths[1].write_text("{}")
    with pytest.raises(SystemExit, match=r"not what experiments\.ablate writes"):
        guidance.main([*map(str, paths)])
