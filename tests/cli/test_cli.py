"""The command line on an untrained model: what it writes, and how it refuses."""

from __future__ import annotations

import dataclasses
import json
import os
import sys

import jax
import numpy as np
import pytest

import scjax
from scjax.cli import main
from scjax.cli.demo import PROMPTS as DEMO
from scjax.cli.output import slug
from scjax.generate import best_of as scenes
from scjax.generate.prompts import SceneScore, best
from scjax.models.denoiser.config import TextCondition
from scjax.scene import empty
from scjax.scene.io import load_json, load_npz, save_npz
from tests.factories.examples import example_batch
from tests.factories.worlds import tiny_model
from tests.generate.test_prompts import Words

PROMPT = "a road with two cars"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model folder; the demo's prompts and one more need no encoder."""
    texts = [PROMPT, "no cars", *DEMO]
    features = {text: found.features for text, found in zip(texts, Words()(texts), strict=True)}
    model = dataclasses.replace(
        tiny_model(TextCondition(Words.width)), text_encoder=Words.name, prompts=features, notes={"steps": 7}
    )  # fmt: skip
    return scjax.save(model, tmp_path_factory.mktemp("cli") / "model")


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("scjax.nn.startup.start_jax", lambda: None)  # no cache folder, no other devices
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["scjax", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return int(stop.value.code or 0), out, err

    return call


def test_generate_writes_what_it_names(run, folder, tmp_path):
    code, out, err = run(
        "generate", PROMPT, "--model", folder, "--steps", 2, "--agents", 3, "--lanes", 5, "-n", 2, "--seed", 4,
        "--negative", "no cars", "--domain", "there", "--out", tmp_path / "made",
        *(word for kind in ("png", "svg", "json", "npz") for word in ("--format", kind)),
    )  # fmt: skip
    assert code == 0 and "2 scenes" in err
    names = sorted(line.rpartition("/")[2] for line in out.splitlines())
    assert names == sorted(f"{slug(PROMPT)}-4-{k}.{kind}" for k in (0, 1) for kind in ("png", "svg", "json", "npz"))
    one, two = (load_npz(tmp_path / "made" / f"{slug(PROMPT)}-4-{k}.npz") for k in (0, 1))
    assert (one.num_agents, one.num_lanes) == (3, 5) and not np.allclose(one.lanes, two.lanes)
    np.testing.assert_allclose(load_json(tmp_path / "made" / f"{slug(PROMPT)}-4-0.json").lanes, one.lanes, atol=1e-5)


def test_generate_in_json_is_for_machines(run, folder):
    code, out, _ = run("generate", PROMPT, "--model", folder, "--steps", 2, "--agents", 3, "--lanes", 5, "--json")
    content = json.loads(out)
    assert code == 0 and content["scenes"][0]["agents"] == 3 and content["scenes"][0]["facts"]["traffic"]
    assert set(content["seconds"]) == {"start", "text", "scenes", "files"}


def test_sampler_guidance_and_temperature_change_the_scene(run, folder, tmp_path):
    scenes = []
    for words in ((), ("--sampler", "dpm++"), ("--guidance", 1), ("--temperature", 0.5)):
        out = tmp_path / str(len(scenes))
        options = ("--steps", 2, "--agents", 3, "--lanes", 5, "--format", "npz", "--out", out)
        assert run("generate", PROMPT, "--model", folder, *options, *words)[0] == 0
        scenes.append(load_npz(out / f"{slug(PROMPT)}-0-0.npz"))
    assert not any(np.allclose(scenes[0].lanes, other.lanes, atol=1e-3) for other in scenes[1:])
    help = " ".join(run("generate", "--help")[1].split())
    assert "[default: ddpm; rectified flow: heun]" in help and "ddpm 25" in help and "dpm++" in help


def test_scenes_are_tidied_unless_raw_and_the_best_candidate_is_kept(run, folder, tmp_path):
    options = ("--model", folder, "--steps", 2, "--agents", 6, "--lanes", 5, "--format", "npz")
    kept = {}
    for name, words in {
        "raw": ["--raw", "--pick", 1],
        "tidied": ["--pick", 1],
        "three": ["--raw", "-n", 3, "--pick", 1],
        "best": ["--raw", "--pick", 3],
    }.items():
        assert run("generate", PROMPT, *options, *words, "--out", tmp_path / name)[0] == 0
        kept[name] = [load_npz(path) for path in sorted((tmp_path / name).iterdir())]
    np.testing.assert_array_equal(kept["tidied"][0].lanes, scjax.repair(kept["raw"][0]).lanes)
    assert not np.array_equal(kept["tidied"][0].lanes, kept["raw"][0].lanes)
    np.testing.assert_array_equal(kept["best"][0].lanes, kept["three"][best(PROMPT, kept["three"])].lanes)


@pytest.mark.parametrize(
    ("prompts", "lanes", "kept", "calls"),
    [
        (["aaa", "a"], [3, 2, 1, 2], [3, 1], [4]),  # both are shown at once
        (["aaa", "aaaa"], [5, 2, 3, 4], [2, 4], [4]),  # the first one keeps the one with fewer faults
    ],
)
def test_best_of_keeps_the_candidate_that_shows_most(monkeypatch, folder, prompts, lanes, kept, calls):
    """A prompt asks for a lane a letter; fewer lanes are fewer faults."""
    left, asked = iter(lanes), []

    def made(key, told, **options):
        asked.append(len(told))
        return [empty(1, next(left)) for _ in told]

    monkeypatch.setattr(scenes, "sample_many", made)
    monkeypatch.setattr(scenes, "with_counts", lambda key, told, model: told)
    monkeypatch.setattr(scenes, "shortcomings", lambda prompt, scene: SceneScore(
        int(len(scene.lanes) != len(prompt)), len(scene.lanes), 0.0
    ))  # fmt: skip
    found = scenes.make(jax.random.key(0), prompts, [scjax.Condition()] * 2, model=scjax.load(folder), pick=2, raw=True)
    assert [len(scene.lanes) for scene in found] == kept and asked == calls and not list(left)


@pytest.mark.parametrize(
    ("faults", "kept", "calls"),
    [
        ([3, 0, 1, 2], 0, [4]),  # nothing is wrong with the second one
        ([3, 2, 1, 2, 2, 3, 4, 5], 1, [4, 4]),  # all shown, but with faults
        ([3, 2, 1, 2, 2, 0, 4, 5], 0, [4, 4]),
    ],
)
def test_a_candidate_without_fault_ends_the_search(monkeypatch, folder, faults, kept, calls):
    left, asked = iter(faults), []

    def made(key, told, **options):
        asked.append(len(told))
        return [empty(1, 1 + next(left)) for _ in told]

    monkeypatch.setattr(scenes, "sample_many", made)
    monkeypatch.setattr(scenes, "with_counts", lambda key, told, model: told)
    monkeypatch.setattr(scenes, "shortcomings", lambda prompt, scene: SceneScore(0, len(scene.lanes) - 1, 0.0))
    model, told = scjax.load(folder), [scjax.Condition()]
    (found,) = scenes.make(jax.random.key(0), ["a"], told, model=model, pick=8, raw=True)
    assert len(found.lanes) - 1 == kept and asked == calls and not list(left)


def test_given_counts_win_with_a_warning(run, folder):
    code, out, err = run("generate", PROMPT, "--model", folder, "--steps", 2, "--agents", 1, "--lanes", 5, "--json")
    assert code == 0 and "warning: the prompt speaks of 2 agents or more" in err
    assert json.loads(out)["scenes"][0]["agents"] == 1


def test_demo_draws_all_prompts(run, folder):
    code, out, err = run("demo", "--model", folder, "--steps", 2)
    assert code == 0 and out.strip() == "scjax-demo-0.png" and "first scene" in err
    assert len([name for name in os.listdir() if name.endswith(".npz")]) == len(DEMO)


def test_caption_plot_and_info(run, folder, tmp_path):
    save_npz(example_batch(2), tmp_path / "scenes.npz")
    code, out, _ = run("caption", "scenes.npz")
    assert code == 0 and len(out.splitlines()) == 2 and out.startswith("The scene")
    code, out, _ = run("caption", "scenes.npz", "--json")
    assert code == 0 and len(json.loads(out)) == 2
    code, out, _ = run("plot", "scenes.npz", "--speeds")
    assert code == 0 and out.strip() == "scenes.png" and (tmp_path / "scenes.png").stat().st_size > 1000
    code, out, _ = run("info", "--model", folder, "--json")
    told = json.loads(out)
    assert code == 0 and told["domains"] == ["here", "there"] and told["text encoder"] == Words.name
    assert "there" in run("info", "--model", folder)[1]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["generate"], 2, "PROMPT"),
        (["generate", PROMPT, "--agents", "0"], 2, "agents"),
        (["generate", PROMPT, "--format", "gif"], 2, "gif"),
        (["generate", PROMPT, "--sampler", "plms"], 2, "plms"),
        (["generate", PROMPT, "--steps", "1"], 2, "steps"),
        (["generate", PROMPT, "--sampler", "heun", "--model", "MODEL"], 1, "choose one of ddpm, ddim, dpm++"),
        (["generate", "", "--model", "MODEL"], 1, "prompt is empty"),
        (["generate", "\udcff", "--model", "MODEL"], 1, "no text"),
        (["generate", PROMPT, "--agents", "62", "--model", "MODEL"], 1, "num_agents is 62"),
        (["generate", PROMPT, "--lanes", "101", "--model", "MODEL"], 1, "num_lanes is 101"),
        (["generate", PROMPT, "--domain", "moon", "--model", "MODEL"], 1, "this model has here, there"),
        (["generate", PROMPT, "--model", "nowhere"], 1, "nowhere is no model folder"),
        (["generate", PROMPT, "--out", "/proc/nothing", "--model", "MODEL"], 1, "cannot be written"),
        (["plot", "nowhere.npz"], 1, "no such file"),
        (["plot", "scenes.txt"], 1, ".npz and .json"),
        (["caption", "broken.json"], 1, "broken.json"),
        (["nonsense"], 2, "nonsense"),
        (["data", "build"], 2, ""),
    ],
)
def test_refusals(run, folder, tmp_path, arguments, code, said):
    (tmp_path / "broken.json").write_text("{")
    found, _, err = run(*(str(folder) if word == "MODEL" else word for word in arguments))
    assert (found, said in err) == (code, True), err


def test_damaged_weights_are_refused(run, folder, tmp_path):
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in folder.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    data = bytearray((copy / "weights.safetensors").read_bytes())
    data[-5] ^= 1
    (copy / "weights.safetensors").write_bytes(bytes(data))
    code, _, err = run("info", "--model", copy)
    assert code == 1 and "sha256" in err


def test_help_of_every_command(run):
    for command in ((), ("demo",), ("generate",), ("caption",), ("plot",), ("info",), ("data",)):
        code, out, _ = run(*command, "--help")
        assert (code == 0 and "Usage" in out) or "usage" in out


def test_slugs_are_file_names():
    assert slug("A busy four-way intersection, 5 cars!") == "a-busy-four-way-intersection-5-cars"
    assert slug("Straße über den Fluß") == "strae-uber-den-flu" and slug("交差点") == "scene"
    assert len(slug("word " * 100)) <= 48
