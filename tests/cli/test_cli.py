"""The command line on an untrained model: what it writes, and how it refuses."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from pathlib import Path

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.cli.demo import PROMPTS as DEMO
from scjax.cli.output import slug
from scjax.generate.prompt_reader import PromptReader, reader_config
from scjax.language.attributes.table import score_attributes
from scjax.language.reader.targets import Reading
from scjax.models.denoiser.config import TextCondition
from scjax.scene import AgentType
from scjax.scene.io import load_json, load_npz, save_npz
from tests.factories.examples import example_batch, example_scene
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

PROMPT = "a road with two cars"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model folder; the demo's prompts and one more need no encoder."""
    features = {text: Words.features(text) for text in (PROMPT, "no cars", *DEMO)}
    model = dataclasses.replace(
        tiny_model(TextCondition(Words.width)), text_encoder=Words.name, prompts=features, notes={"steps": 7}
    )
    return scjax.save(model, tmp_path_factory.mktemp("cli") / "model")


def test_generate_writes_what_it_names(run, folder, tmp_path):
    code, out, err = run(
        "generate",
        PROMPT,
        "--model",
        folder,
        "--num-steps",
        2,
        "--agents",
        3,
        "--lanes",
        5,
        "-n",
        2,
        "--seed",
        4,
        "--negative",
        "no cars",
        "--domain",
        "there",
        "--out",
        tmp_path / "made",
        *(word for kind in ("png", "svg", "json", "npz") for word in ("--format", kind)),
    )
    assert code == 0 and "2 scenes" in err
    names = sorted(line.rpartition("/")[2] for line in out.splitlines())
    assert names == sorted(f"{slug(PROMPT)}-4-{k}.{kind}" for k in (0, 1) for kind in ("png", "svg", "json", "npz"))
    one, two = (load_npz(tmp_path / "made" / f"{slug(PROMPT)}-4-{k}.npz") for k in (0, 1))
    assert (one.num_agents, one.num_lanes) == (3, 5) and not np.allclose(one.lanes, two.lanes)
    np.testing.assert_allclose(load_json(tmp_path / "made" / f"{slug(PROMPT)}-4-0.json").lanes, one.lanes, atol=1e-5)


@pytest.mark.parametrize("is_terminal", [True, False])
def test_generate_says_on_a_terminal_how_far_it_is(run, folder, monkeypatch, is_terminal):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    code, _, err = run("generate", PROMPT, "--model", folder, "--num-steps", 2, "--agents", 3, "--lanes", 5)
    assert code == 0 and ("scenes:   0%" in err) == is_terminal


def test_generate_prints_json(run, folder):
    code, out, _ = run("generate", PROMPT, "--model", folder, "--num-steps", 2, "--agents", 3, "--lanes", 5, "--json")
    content = json.loads(out)
    assert code == 0 and content["scenes"][0]["agents"] == 3 and content["scenes"][0]["shows"]["layout"]
    assert set(content["seconds"]) == {"start", "scenes", "files"}


def test_generate_without_a_prompt_samples_an_unconditional_model(run, tmp_path):
    model = scjax.save(tiny_model(), tmp_path / "model")
    options = ("--model", model, "-n", 2, "--num-steps", 2, "--lanes", 5, "--best-of", 1, "--format", "npz")
    assert run("generate", "--no-prompt", *options)[0] == 0
    assert [load_npz(tmp_path / f"scene-0-{k}.npz").num_lanes for k in (0, 1)] == [5, 5]


def test_sampler_guidance_and_temperature_change_the_scene(run, folder, tmp_path):
    scenes = []
    for words in ((), ("--sampler", "dpm++"), ("--guidance", 1), ("--temperature", 0.5)):
        out = tmp_path / str(len(scenes))
        options = ("--num-steps", 2, "--agents", 3, "--lanes", 5, "--format", "npz", "--out", out)
        assert run("generate", PROMPT, "--model", folder, *options, *words)[0] == 0
        scenes.append(load_npz(out / f"{slug(PROMPT)}-0-0.npz"))
    assert not any(np.allclose(scenes[0].lanes, other.lanes, atol=1e-3) for other in scenes[1:])
    help = " ".join(run("generate", "--help")[1].split())
    assert "[default: ddpm; rectified flow: heun]" in help and "ddpm 25" in help and "dpm++" in help


def test_generate_repairs_and_takes_the_best_candidate(run, folder, tmp_path):
    """By default; the library has the same scenes for the same options."""
    options = ("--model", folder, "--num-steps", 2, "--agents", 6, "--lanes", 5, "--format", "npz")
    scenes = {}
    for name, words in {
        "plain": ["--no-repair", "--best-of", 1],
        "repaired": ["--best-of", 1],
        "default": [],
        "four": ["--best-of", 4, "--repair"],
    }.items():
        assert run("generate", PROMPT, *options, *words, "--out", tmp_path / name)[0] == 0
        (path,) = (tmp_path / name).iterdir()
        scenes[name] = load_npz(path)
    np.testing.assert_array_equal(scenes["repaired"].lanes, scjax.repair(scenes["plain"]).lanes)
    assert not np.array_equal(scenes["repaired"].lanes, scenes["plain"].lanes)
    chex.assert_trees_all_equal(scenes["default"].to_dict(), scenes["four"].to_dict())
    condition = scjax.Condition(prompt=PROMPT, num_agents=6, num_lanes=5)
    (same,) = scjax.sample(
        jax.random.key(0), [condition], model=scjax.load(folder), num_steps=2, best_of=4, repair=True
    )
    np.testing.assert_array_equal(scenes["default"].lanes, same.lanes)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (["--steps", 2, "--pick", 2], ["--num-steps", 2, "--best-of", 2]),
        (["--steps=2", "--raw"], ["--num-steps", 2, "--no-repair"]),
        (["--steps", 2, "--no-steer"], ["--num-steps", 2, "--no-energy-guidance"]),
    ],
)
def test_old_flags_work_with_a_warning(run, folder, tmp_path, old, new):
    options = ("--model", folder, "--agents", 6, "--lanes", 5, "--format", "npz")
    scenes = []
    for name, words in (("old", old), ("new", new)):
        code, out, err = run("generate", PROMPT, *options, *words, "--out", tmp_path / name)
        assert code == 0
        flags = [str(word).partition("=")[0] for word in words if str(word).startswith("--")]
        for flag, current in zip(flags, [word for word in new if str(word).startswith("--")], strict=True):
            assert (f"warning: {flag} is now {current}" in err) == (name == "old")
        scenes.append(load_npz(out.strip()))
    chex.assert_trees_all_equal(scenes[0].to_dict(), scenes[1].to_dict())


def test_old_flags_that_are_gone_name_their_successor(run):
    for command in (("generate", PROMPT), ("demo",)):
        code, _, err = run(*command, "--tries", 4)
        assert code == 2 and "--best-of" in err


def test_generate_shows_what_it_understood_and_what_it_cannot_meet(run, folder, monkeypatch):
    known = {PROMPT: Reading({"vehicles": (2, 2)}, {"vehicles": 0.9})}
    reader = PromptReader(reader_config(8, width=16, heads=2), {}, "none", known)
    call, read = PromptReader.__call__, []
    monkeypatch.setattr(PromptReader, "__call__", lambda self, texts: read.append(texts) or call(self, texts))
    monkeypatch.setattr("scjax.generate.readings.load_reader", lambda: reader)
    monkeypatch.setattr("scjax.generate.readings.reads_requests", lambda model: True)
    words = ["generate", PROMPT, "--model", folder, "--num-steps", 2, "--lanes", 5]
    code, _, err = run(*words)
    assert code == 0 and "understood: vehicles 2" in err and "warning" not in err
    assert read == [[PROMPT]]  # once: what is shown is what is used
    code, out, err = run(*words, "--agents", 1, "--json")
    assert code == 0 and "warning: 'a road with two cars' asks for 2 agents or more" in err
    (report,) = json.loads(out)["scenes"]
    assert report["agents"] == 1 and report["request"] == {"vehicles": [2, 2]} and report["misses"] == ["vehicles"]


def test_demo_draws_all_prompts(run, folder):
    code, out, err = run("demo", "--model", folder, "--num-steps", 2)
    assert code == 0 and out.strip() == "scjax-demo-0.png" and "first scene" in err
    assert len([name for name in os.listdir() if name.endswith(".npz")]) == len(DEMO)


def test_caption_plot_and_info(run, folder, tmp_path):
    save_npz(example_batch(2), tmp_path / "scenes.npz")
    code, out, _ = run("caption", "scenes.npz")
    assert code == 0 and len(out.splitlines()) == 2
    code, out, _ = run("caption", "scenes.npz", "--json", "--style", "terse", "--seed", "3")
    captions = json.loads(out)
    assert code == 0 and len(captions) == 2
    scenes = load_npz(tmp_path / "scenes.npz")
    for row, caption in enumerate(captions):
        assert caption["style"] == "terse" and not score_attributes(scenes[row], caption["request"]).misses
    code, out, _ = run("caption", "scenes.npz", "--language", "de", "--json")
    assert code == 0 and {caption["language"] for caption in json.loads(out)} == {"de"}
    code, _, err = run("caption", "scenes.npz", "--language", "de", "--style", "terse")
    assert code == 1 and "style 'terse' is none of language 'de'" in err
    code, _, err = run("caption", "scenes.npz", "--style", "song")
    assert code == 1 and "there is no style 'song': choose from terse" in err
    code, out, _ = run("plot", "scenes.npz", "--speeds")
    assert code == 0 and out.strip() == "scenes.png" and (tmp_path / "scenes.png").stat().st_size > 1000
    code, out, _ = run("info", "--model", folder, "--json")
    content = json.loads(out)
    assert code == 0 and content["domains"] == ["here", "there"] and content["text encoder"] == Words.name
    assert "there" in run("info", "--model", folder)[1]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["generate"], 2, "PROMPT"),
        (["generate", PROMPT, "--agents", "0"], 2, "agents"),
        (["generate", PROMPT, "--format", "gif"], 2, "gif"),
        (["generate", PROMPT, "--sampler", "plms"], 2, "plms"),
        (["generate", PROMPT, "--num-steps", "1"], 2, "steps"),
        (["generate", PROMPT, "--sampler", "heun", "--model", "MODEL"], 1, "choose one of ddpm, ddim, dpm++"),
        (["generate", "", "--model", "MODEL"], 1, "prompt is empty"),
        (["generate", "\udcff", "--model", "MODEL"], 1, "no text"),
        (["generate", PROMPT, "--agents", "62", "--model", "MODEL"], 1, "num_agents is 62"),
        (["generate", PROMPT, "--lanes", "101", "--model", "MODEL"], 1, "num_lanes is 101"),
        (["generate", PROMPT, "--domain", "moon", "--model", "MODEL"], 1, "this model has here, there"),
        (["generate", PROMPT, "--model", "nowhere"], 1, "nowhere is no model folder"),
        (["generate", PROMPT, "--out", "/proc/nothing", "--model", "MODEL"], 1, "cannot be written"),
        (["plot", "nowhere.npz"], 1, "no such file"),
        (["plot", "scenes.txt"], 1, "no such file"),
        (["caption", "broken.json"], 1, "broken.json"),
        (["nonsense"], 2, "nonsense"),
        (["data", "build"], 2, ""),
    ],
)
def test_commands_refuse_bad_input(run, folder, tmp_path, arguments, code, message):
    (tmp_path / "broken.json").write_text("{")
    actual, _, err = run(*(str(folder) if word == "MODEL" else word for word in arguments))
    assert (actual, message in err) == (code, True), err


def test_info_refuses_damaged_weights(run, folder, tmp_path):
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in folder.iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    data = bytearray((copy / "weights.safetensors").read_bytes())
    data[-5] ^= 1
    (copy / "weights.safetensors").write_bytes(bytes(data))
    code, _, err = run("info", "--model", copy)
    assert code == 1 and "sha256" in err


def test_every_command_has_help(run):
    for command in ((), ("demo",), ("generate",), ("caption",), ("plot",), ("info",), ("data",)):
        code, out, _ = run(*command, "--help")
        assert (code == 0 and "Usage" in out) or "usage" in out


def test_slug_is_a_file_name():
    assert slug("a roundabout with 5 cars") == "a-roundabout-with-5-cars"
    assert slug("Straße über den Fluß").startswith("straße-über-den-fluß-") and slug("交差点") == "交差点"
    assert len(slug("word " * 100)) <= 55


def test_slug_differs_where_prompts_differ():
    start = "a busy four-way intersection with a red light, five vehicles and "
    prompts = [
        f"{start}two pedestrians",
        f"{start}a cyclist",
        "两辆车",
        "一条路",
        "🚗🚗",
        "🚶",
        "two cars",
        "two cars!",
    ]
    assert len({slug(prompt) for prompt in prompts}) == len(prompts)


def test_caption_warns_where_agent_0_is_no_ego(run, tmp_path):
    scene = example_scene(agents=1)
    scene.agent_types[0] = AgentType.STATIC
    save_npz(scene, tmp_path / "cone.npz")
    code, out, err = run("caption", tmp_path / "cone.npz")
    assert code == 0 and out and "agent 0 is a static" in err
    assert run("caption", tmp_path / "cone.npz", "--strict")[0] == 1


@pytest.mark.parametrize(("flag", "code"), [((), 1), (("--debug",), None)])
def test_unexpected_errors_are_one_line(run, monkeypatch, tmp_path, flag, code):
    def fail(*_, **__):
        raise TypeError("a fault\nof ours")

    monkeypatch.setattr("scjax.scene.io.load_npz", fail)
    save_npz(example_scene(), tmp_path / "scene.npz")
    if code is None:
        with pytest.raises(TypeError, match="a fault"):
            run("caption", tmp_path / "scene.npz", *flag)
        return
    result, _, err = run("caption", tmp_path / "scene.npz", *flag)
    assert result == code and err.count("\n") == 1 and "unexpected TypeError: a fault of ours" in err


@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning")
def test_debug_shows_the_trace_of_a_training(run, monkeypatch, tmp_path):
    def fail(*_):
        raise TypeError("a fault of ours")

    monkeypatch.setattr("scjax.train.loop.train", fail)
    arguments = ("--config=counts:tiny", f"--workdir={tmp_path}", "--no-keep-memory")
    assert run("train", *arguments)[0] == 1
    with pytest.raises(TypeError, match="a fault"):
        run("--debug", "train", *arguments)


@pytest.mark.parametrize("form", ["scene", "recording", "map", "rig"])
def test_schema_is_the_published_one(run, form):
    """docs/ has what ``scjax schema`` prints: write it again with the command if this fails."""
    published = Path(__file__).resolve().parents[2] / "docs" / f"{form}.schema.json"
    code, out, _ = run("schema", form)
    assert code == 0 and json.loads(out) == json.loads(published.read_text())
