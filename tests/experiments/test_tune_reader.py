"""Training of a reader of prompts together with its encoder."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from experiments import tune_reader
from scjax.encoders.e5 import E5
from scjax.encoders.text import load_text_encoder
from scjax.generate.prompt_reader import ENCODER_LAYERS, PromptReader, load_reader, reader_config, save_reader
from scjax.language.grammar.compose import Composition
from scjax.models.reader_network import reader_network
from tests.factories.encoder_folders import CONFIG, write_encoder

PROMPTS = tuple(
    Composition(f"a road with {number} cars", {"vehicles": (number, number)}, "terse", "en") for number in range(2, 7)
)
WORDS = ["--steps", "4", "--evaluate-every", "2"]


@pytest.fixture
def start(tmp_path, monkeypatch):
    """A tiny reader, and few prompts."""
    config = dataclasses.replace(CONFIG, num_hidden_layers=ENCODER_LAYERS)
    monkeypatch.setenv(E5.variable, str(write_encoder(tmp_path / "encoder", config)))
    encoder = load_text_encoder(E5, layers=ENCODER_LAYERS)
    config = reader_config(encoder.width, width=16, heads=2)
    params = reader_network(config).init(jax.random.key(0))
    save_reader(PromptReader(config, params, encoder.name), tmp_path / "start", {})
    monkeypatch.setattr(tune_reader, "written_prompts", lambda: PROMPTS)
    monkeypatch.setattr(tune_reader, "SIZES", ((32, 2),))
    return tmp_path / "start"


def test_training_continues_and_changes_the_encoder(start, tmp_path, monkeypatch):
    """A run that was killed after its second step ends as one that was not."""
    batch, numbers = tune_reader._batch, []

    def counted(encoder, trained, args, number):
        if number == 3 and len(numbers) == 6:
            raise MemoryError
        numbers.append(number)
        assert trained == [list(PROMPTS[1:])]
        return batch(encoder, trained, args, number)

    monkeypatch.setattr(tune_reader, "_batch", counted)
    words = ["--start", str(start), *WORDS]
    tune_reader.main([str(tmp_path / "whole"), *words])
    with pytest.raises(MemoryError):
        tune_reader.main([str(tmp_path / "killed"), *words])
    numbers.append(0)
    tune_reader.main([str(tmp_path / "killed"), *words])
    assert numbers == [*(1, 2, 3, 4), *(1, 2), 0, *(3, 4)]
    whole, killed = (load_reader(tmp_path / name / "model") for name in ("whole", "killed"))
    for one, two in ((whole.params, killed.params), (whole.layers, killed.layers)):
        assert all(map(np.array_equal, jax.tree.leaves(one), jax.tree.leaves(two)))
    own = load_reader(start).encoder.params["layers"]
    assert whole.layers is not None and whole.layers.keys() == own.keys()
    assert np.abs(np.asarray(whole.layers[0]["query"]["kernel"]) - own[0]["query"]["kernel"]).max() > 1e-6
    whole(["a road with two cars"])


def test_batches_keep_numbers_and_are_those_of_their_step(start):
    reader = load_reader(start)
    args = type("Args", (), {"seed": 7, "hide": 0.9})
    ids, kept, numbers, mask, named, ends = tune_reader._batch(reader.encoder, [list(PROMPTS)], args, 3)
    assert ids.shape == kept.shape == numbers.shape == mask.shape == (2, 32) and len(named) == len(ends) == 2
    assert kept[numbers > 0].all() and not kept[mask].all() and not (ids[~mask]).any()
    again = tune_reader._batch(reader.encoder, [list(PROMPTS)], args, 3)
    assert all(map(np.array_equal, (ids, kept, numbers, mask, named, ends), again))


@pytest.mark.parametrize(
    ("words", "message"), [(["--hide", "1"], "share from 0 to below 1"), (["--steps", "0"], "1 or")]
)
def test_bad_options_are_named(words, message, tmp_path, capsys):
    with pytest.raises(SystemExit):
        tune_reader.main([str(tmp_path / "run"), *words])
    assert message in capsys.readouterr().err
