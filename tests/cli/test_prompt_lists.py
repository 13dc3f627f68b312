"""scjax generate --prompts FILE: lists of prompts, their folders, and what is there already."""

from __future__ import annotations

import dataclasses
import importlib
import json

import pytest

import scjax
from scjax.cli.demo import PROMPTS
from scjax.cli.prompt_lists import read_prompt_list
from scjax.generate import sample
from scjax.language.attributes.vector import feature_names
from scjax.models.denoiser.config import TextCondition
from scjax.scene.io import load_npz
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

LINES = [{"id": "a1", "prompt": "a road"}, {"id": "a2", "prompt": "two cars"}, {"id": 3, "prompt": "a road"}]


def _write(path, lines):
    path.write_text("\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines))
    return str(path)


def test_lists_are_read_in_order(tmp_path):
    entries = read_prompt_list(_write(tmp_path / "list.jsonl", [LINES[0], "", {**LINES[2], "asks": {}}]))
    assert entries == [("a1", "a road"), ("3", "a road")]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "holds no prompts"),
        (["{"], "line 1"),
        ([{"id": "a"}], "line 1.*prompt"),
        ([{"prompt": "a road"}], "line 1.*id"),
        ([{"id": "a", "prompt": 3}], "line 1.*prompt"),
        ([LINES[0], {"id": "../a", "prompt": "a"}], "line 2: id '../a' is no name of a folder"),
        ([LINES[0], {"id": "A1", "prompt": "b"}], "line 2: id 'A1' is that of line 1"),
        ([{"id": "a", "prompt": " "}], "line 1: prompt is empty"),
    ],
)
def test_faults_are_named_by_line(lines, message, tmp_path):
    with pytest.raises(ValueError, match=rf"list\.jsonl.*{message}"):
        read_prompt_list(_write(tmp_path / "list.jsonl", lines))


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"word\.jsonl cannot be read"):
        read_prompt_list(tmp_path / "word.jsonl")


def test_lists_are_generated_once_and_continued(tmp_path, run, monkeypatch):
    """What is there is left; what is missing comes out as it would have."""
    monkeypatch.setattr(importlib.import_module("scjax.cli.generate"), "CHUNK", 2)
    monkeypatch.setattr("scjax.generate.text_streams.load_text_encoder", Words)
    model = dataclasses.replace(tiny_model(TextCondition(Words.width)), text_encoder=Words.name)
    scjax.save(model, tmp_path / "model")
    words = ["generate", "--prompts", _write(tmp_path / "list.jsonl", LINES), "--format", "npz"]
    words += ["--model", str(tmp_path / "model"), "--num-steps", "2", "--best-of", "1", "--lanes", "3", "--agents", "2"]
    code, out, _ = run(*words, "--out", str(tmp_path / "out"), "--json")
    assert code == 0 and [one["id"] for one in json.loads(out)["scenes"]] == ["a1", "a2", "3"]
    files = sorted((tmp_path / "out").rglob("*.npz"))
    assert [path.parent.name for path in files] == ["3", "a1", "a2"]
    assert not (load_npz(files[0]).lanes == load_npz(files[1]).lanes).all()  # the same prompt, another place
    before = [path.read_bytes() for path in files]
    files[0].unlink()
    calls = []
    real = sample.sample_scenes
    monkeypatch.setattr(
        sample, "sample_scenes", lambda key, some, **rest: calls.append(some) or real(key, some, **rest)
    )
    code, out, _ = run(*words, "--out", str(tmp_path / "out"))
    assert code == 0 and [len(some) for some in calls] == [1] and out.strip() == str(files[0])
    assert [path.read_bytes() for path in files] == before


def test_warnings_name_the_entry(tmp_path, run):
    """Of a prompt of the demo, whose reading ships."""
    scjax.save(tiny_model(attributes=feature_names()), tmp_path / "model")
    lines = [{"id": "few", "prompt": PROMPTS[0]}]
    words = ["generate", "--prompts", _write(tmp_path / "list.jsonl", lines), "--agents", "1", "--lanes", "3"]
    words += ["--model", str(tmp_path / "model")]
    code, _, err = run(*words, "--num-steps", "2", "--best-of", "1", "--out", str(tmp_path / "out"))
    assert code == 0 and "scjax: warning: few: " in err and "the given number is taken" in err
    assert "understood" not in err


def test_either_prompts_or_a_list(run, tmp_path):
    assert run("generate")[0] == 2
    assert run("generate", "a road", "--prompts", _write(tmp_path / "list.jsonl", LINES))[0] == 2
