"""The reader of prompts: its network, its files, its training and its command."""

from __future__ import annotations

import dataclasses
import json

import jax
import numpy as np
import pytest

from experiments import reader_texts, train_reader
from scjax.encoders.e5 import E5
from scjax.encoders.text import load_text_encoder
from scjax.generate.prompt_reader import (
    ENCODER_LAYERS,
    PromptReader,
    load_reader,
    reader_config,
    save_reader,
    token_inputs,
)
from scjax.language.attributes.table import check_attributes
from scjax.language.grammar.prompts import FOLDER, written_prompts
from scjax.models.reader_network import reader_network
from tests.factories.encoder_folders import CONFIG, write_encoder

SIZES = {"width": 16, "heads": 2}


@pytest.fixture(autouse=True)
def encoder(tmp_path, monkeypatch):
    """A tiny encoder in place of the multilingual one."""
    config = dataclasses.replace(CONFIG, num_hidden_layers=ENCODER_LAYERS + 1)
    monkeypatch.setenv(E5.variable, str(write_encoder(tmp_path / "encoder", config)))
    return load_text_encoder(E5, layers=ENCODER_LAYERS)


def _save(encoder, folder, **sizes):
    config = reader_config(encoder.width, **{**SIZES, **sizes})
    save_reader(PromptReader(config, reader_network(config).init(jax.random.key(0)), encoder.name), folder, {})
    return folder


def test_padding_and_batch_never_matter():
    config = reader_config(8, **SIZES)
    params = reader_network(config).init(jax.random.key(1))
    rng = np.random.default_rng(0)
    features, numbers = rng.normal(size=(2, 11, 8)).astype(np.float32), rng.integers(0, 20, (2, 11))
    mask = np.arange(11)[None] < np.array([[11], [5]])
    apply = jax.jit(reader_network(config).apply)
    both = apply(params, features, numbers, mask)
    alone = apply(params, *token_inputs(features[1, :5], numbers[1, :5]))
    garbage = apply(params, np.where(mask[..., None], features, np.nan), numbers, mask)
    for one, two, three in zip(both, alone, garbage, strict=True):
        np.testing.assert_allclose(one[1], two[0], atol=1e-5)
        np.testing.assert_array_equal(one, three)


def test_numbers_are_read():
    config = reader_config(8, **SIZES)
    params = reader_network(config).init(jax.random.key(1))
    inputs = token_inputs(np.ones((4, 8), np.float32), np.zeros(4, np.int32))
    other = (inputs[0], inputs[1] + 3, inputs[2])
    apply = jax.jit(reader_network(config).apply)
    one, two = apply(params, *inputs), apply(params, *other)
    assert np.abs(one.ends - two.ends).max() > 1e-3


def test_first_layers_are_those_of_the_whole_encoder(encoder):
    whole = load_text_encoder(E5)
    assert encoder.name != whole.name and len(encoder.params["layers"]) == ENCODER_LAYERS
    with pytest.raises(ValueError, match="no 9 layers"):
        load_text_encoder(E5, layers=9)


def test_layers_that_were_trained_replace_those_of_the_encoder(encoder, tmp_path):
    plain = load_reader(_save(encoder, tmp_path / "plain"))
    layers = jax.tree.map(lambda array: 1.5 * np.asarray(array), encoder.params["layers"])
    save_reader(dataclasses.replace(plain, layers=layers), tmp_path / "tuned", {})
    tuned = load_reader(tmp_path / "tuned")
    jax.tree.map(lambda one, two: np.testing.assert_allclose(one, two, rtol=2e-3, atol=1e-3), tuned.layers, layers)
    ours, own = tuned.outputs("a road with two cars"), plain.outputs("a road with two cars")
    assert np.abs(ours.named - own.named).max() > 1e-3
    np.testing.assert_array_equal(
        encoder.params["layers"][0]["up"]["bias"], plain.encoder.params["layers"][0]["up"]["bias"]
    )


def test_layers_of_another_network_are_refused(encoder, tmp_path):
    reader = load_reader(_save(encoder, tmp_path / "reader"))
    with pytest.raises(ValueError, match="the layers do not fit the text encoder"):
        dataclasses.replace(reader, layers={0: encoder.params["layers"][0]})(["a road"])


def test_reader_is_saved_and_read(encoder, tmp_path):
    folder = _save(encoder, tmp_path / "reader")
    reader = load_reader(folder)
    one, two = "a road with two cars", "three lanes"
    together = reader([one, two])
    alone = load_reader(folder)([two])[0]
    assert alone.request == together[1].request and alone.shares == pytest.approx(together[1].shares, abs=1e-5)
    assert together[0].request.keys() == together[0].shares.keys()
    with pytest.raises(ValueError, match="prompt is empty"):
        reader([" "])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda index: index.pop("files"), "`files`.*copy the folder"),
        (lambda index: index["config"].update(levels=9), "another table of attributes"),
        (lambda index: index["config"].update(width=32), "do not fit the config"),
        (lambda index: index["config"].update(named=3), "another table of attributes: train it anew"),
        (lambda index: index["config"].update(width=3), "multiple of"),
        (lambda index: index.update(readings={"a": {"request": {"layout": "L"}, "shares": {}}}), "layout has no value"),
    ],
)
def test_damaged_readers_are_named(change, message, encoder, tmp_path):
    folder = _save(encoder, tmp_path / "reader")
    index = json.loads((folder / "reader.json").read_text())
    change(index)
    (folder / "reader.json").write_text(json.dumps(index))
    with pytest.raises(ValueError, match=rf"reader\.json.*{message}"):
        load_reader(folder)


def test_another_encoder_is_refused(encoder, tmp_path):
    reader = dataclasses.replace(load_reader(_save(encoder, tmp_path / "reader")), encoder_name="word")
    with pytest.raises(ValueError, match="reads the encoder word"):
        reader(["a road"])


def test_the_end_of_a_long_prompt_is_not_read(encoder, tmp_path, monkeypatch):
    monkeypatch.setattr("scjax.generate.prompt_reader.MAX_TOKENS", 12)
    folder = _save(encoder, tmp_path / "reader")
    with pytest.warns(UserWarning, match="a prompt of 21 words is too long: its end is not read"):
        (long,) = load_reader(folder)([" ".join(["a road with two cars", *["and"] * 16])])
    assert check_attributes(long.request) == long.request


def test_readings_of_the_last_call_are_remembered(encoder, tmp_path, monkeypatch):
    """And the first ones, which are those that ship."""
    monkeypatch.setattr("scjax.generate.prompt_reader._MOST_KEPT", 3)
    reader = load_reader(_save(encoder, tmp_path / "reader"))
    for texts in (["a road"], ["one", "two"], ["three", "four"]):
        reader(texts)
    assert list(reader.readings) == ["a road", "three", "four"]


def test_saved_readings_need_no_encoder(encoder, tmp_path):
    reader = load_reader(_save(encoder, tmp_path / "reader"))
    read = reader(["a  road", "two cars"])
    save_reader(reader, tmp_path / "known", {})
    known = dataclasses.replace(load_reader(tmp_path / "known"), encoder_name="word")
    assert known(["a road", "two cars", "a road"]) == [*read, read[0]]


def _every_500th(folder):
    """A folder with a part of the written prompts: to read all takes ten seconds."""
    folder.mkdir()
    for path in FOLDER.glob("*.tsv"):
        lines = path.read_text(encoding="utf-8").splitlines()[::500]
        (folder / path.name).write_text("\n".join(lines), encoding="utf-8")
    return folder


def test_training_continues_and_its_model_reads(tmp_path, run, monkeypatch):
    """A run that was killed after its second step ends as one that was not."""
    folders, numbers = [tmp_path / "whole", tmp_path / "killed"], []
    words = ["--texts", "40", "--held-back", "8", "--copies", "2"]
    words += ["--evaluate-every", "2", "--steps", "4", "--batch", "4"]
    batch = train_reader._batch
    prompts = written_prompts(_every_500th(tmp_path / "prompts"))
    monkeypatch.setattr(train_reader, "_EVALUATED", 8)
    for module in (train_reader, reader_texts):
        monkeypatch.setattr(module, "written_prompts", lambda: prompts)
        monkeypatch.setattr(module, "LENGTHS", reader_texts.LENGTHS[-1:])  # for every other one, two programs more

    def counted(texts, args, number):
        if number == 3 and len(numbers) == 6:
            raise MemoryError
        numbers.append(number)
        rows = np.concatenate(texts.trained["prompts"])
        assert len(rows) == 2 * (len(prompts) - len(texts.held_back["prompts"]))
        assert not set(rows) & {*texts.held_back["prompts"], *texts.held_back["composed"]}
        return batch(texts, args, number)

    monkeypatch.setattr(train_reader, "_batch", counted)
    train_reader.main([str(folders[0]), *words])
    with pytest.raises(MemoryError):
        train_reader.main([str(folders[1]), *words])
    numbers.append(0)
    train_reader.main([str(folders[1]), *words])
    assert numbers == [*(1, 2, 3, 4), *(1, 2), 0, *(3, 4)]
    whole, killed = (load_reader(folder / "model").params for folder in folders)
    assert all(map(np.array_equal, jax.tree.leaves(whole), jax.tree.leaves(killed)))
    with pytest.raises(ValueError, match=r"another run.*config\.seed is 11 there and 5 here"):
        train_reader.main([str(folders[1]), *words, "--seed", "5"])
    begun = [str(tmp_path / "begun"), *words, "--start", str(folders[0] / "model")]
    train_reader.main([*begun, "--blocks", "3"])
    assert load_reader(tmp_path / "begun" / "model").config.blocks == 3
    model = ["--reader", str(folders[0] / "model")]
    code, out, _ = run("read", "a road with two cars", *model, "--json")
    assert code == 0 and json.loads(out)[0].keys() == {"prompt", "request", "shares", "likely", "contradictions"}
    code, out, _ = run("read", "a road", *model)
    assert code == 0 and out.startswith("a road\n  ")
    code, _, errors = run("read", "a road", "--reader", str(folders[0]))
    assert code == 1 and "no folder of a reader" in errors
