"""Text encoders: features, and loading from folders, sound and damaged."""

from __future__ import annotations

import json
import random

import jax
import numpy as np
import pytest
import safetensors.numpy

from scjax.encoders import bert, t5
from scjax.encoders.base import pure_functions
from scjax.encoders.text import clean_text, load_text_encoder
from scjax.nn.functional import count
from tests.factories.encoder_folders import WORDS, write_encoder


def test_encoder_text_alone_equals_text_among_others(tmp_path):
    encoder = load_text_encoder(write_encoder(tmp_path))
    texts = ["a road with two lanes", "left", "three cars and a road that bend left " * 5]
    for one, text in zip(encoder(texts), texts, strict=True):
        np.testing.assert_allclose(one.features, encoder([text])[0].features, atol=1e-5)
        assert one.features.shape == (len(one.texts), encoder.width)


def test_encoder_cuts_long_texts(tmp_path):
    encoder = load_text_encoder(write_encoder(tmp_path))
    assert encoder.is_cut("a " * 41) and not encoder.is_cut("a " * 40)
    assert len(encoder(["a " * 10_000])[0].features) == 40


def test_load_reads_prefixed_keys_and_t5(tmp_path):
    encoder = load_text_encoder(write_encoder(tmp_path / "prefixed", prefix="bert."))
    np.testing.assert_array_equal(
        encoder(["two cars"])[0].features,
        load_text_encoder(write_encoder(tmp_path / "plain"))(["two cars"])[0].features,
    )
    config = t5.T5Config(vocab_size=len(WORDS), d_model=16, d_kv=4, d_ff=24, num_layers=2, num_heads=2)
    umt5 = load_text_encoder(write_encoder(tmp_path / "umt5", config, "umt5"))
    assert umt5.name.startswith("umt5-") and umt5(["a road"])[0].features.shape == (2, 16)


def test_t5_position_buckets():
    offsets = np.array([[-200, -128, -20, -8, -1, 0, 1, 7, 8, 20, 127, 128, 500]])
    expected = [15, 15, 10, 8, 1, 0, 17, 23, 24, 26, 31, 31, 31]
    assert t5.position_bucket(offsets, 32, 128)[0].tolist() == expected


def test_networks_have_the_published_sizes():
    xxl = t5.T5Config(d_model=4096, d_ff=10240, num_layers=24, num_heads=64)
    sizes = {
        "minilm": (bert.NETWORK, bert.BertConfig(), 22_713_216 - 384 * 384 - 384),  # tokens do not need the pooler
        "xxl": (t5.NETWORK, xxl, 5_680_910_336),
        "small": (t5.NETWORK, t5.T5Config(), None),
    }
    for network, config, expected in sizes.values():
        number = count(jax.eval_shape(pure_functions(network, config).init, jax.random.key(0)))
        assert expected is None or number == expected


def test_load_names_weights_of_another_network(tmp_path):
    write_encoder(tmp_path)
    content = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps(content | {"num_hidden_layers": 3}))
    with pytest.raises(ValueError, match=r"missing: encoder\.layer\.2"):
        load_text_encoder(tmp_path)
    (tmp_path / "config.json").write_text(json.dumps(content | {"model_type": "gpt2"}))
    with pytest.raises(ValueError, match=r"'gpt2' is not supported"):
        load_text_encoder(tmp_path)


@pytest.mark.parametrize(
    ("name", "match"),
    [("config.json", "is no JSON"), ("model.safetensors", "cannot be read"), ("tokenizer.json", "cannot be read")],
)
def test_load_names_damaged_files(tmp_path, name, match):
    folder = write_encoder(tmp_path / name.partition(".")[0])
    (folder / name).write_bytes(b"{")
    with pytest.raises(ValueError, match=rf"{name}.*{match}"):
        load_text_encoder(folder)


@pytest.mark.parametrize("text", ["", " \n\t ", 7, b"bytes", "\udcff"])
def test_clean_text_refuses_what_is_no_prompt(text):
    with pytest.raises(ValueError, match="prompt"):
        clean_text(text)


def write_config(folder, **changes):
    path = folder / "config.json"
    content = {**json.loads(path.read_text()), **changes}
    path.write_text(json.dumps({name: value for name, value in content.items() if value != "gone"}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_attention_heads": 0}, "num_attention_heads"),  # case 15
        ({"num_attention_heads": 3}, "num_attention_heads 3"),
        ({"hidden_size": "16"}, "hidden_size"),
        ({"hidden_size": 10**12}, "hidden_size"),
        ({"hidden_size": None}, "hidden_size"),
        ({"vocab_size": 2**23}, "word_embeddings.weight is .* its sizes need"),
        ({"vocab_size": "gone"}, "word_embeddings.weight"),
        ({"num_hidden_layers": 0}, "num_hidden_layers"),
        ({"intermediate_size": 25}, "intermediate.dense.weight"),
        ({"layer_norm_eps": float("nan")}, r"config\.json: layer_norm_eps: expected `float` > 0"),
        ({"layer_norm_eps": -1.0}, "layer_norm_eps"),
        ({"hidden_act": "relu"}, "hidden_act is 'relu'"),
        ({"model_type": ["bert"]}, "model type"),
    ],
)
def test_load_names_odd_fields_of_the_config(tmp_path, changes, message):
    write_config(write_encoder(tmp_path), **changes)
    with pytest.raises(ValueError, match=rf"config\.json.*{message}|{message}"):
        load_text_encoder(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_load_refuses_weights_that_are_not_finite(tmp_path, value):
    state = safetensors.numpy.load_file(write_encoder(tmp_path) / "model.safetensors")
    state["embeddings.LayerNorm.weight"][3] = value
    safetensors.numpy.save_file(state, tmp_path / "model.safetensors")
    with pytest.raises(ValueError, match=r"embeddings\.LayerNorm\.weight are not finite"):
        load_text_encoder(tmp_path)


@pytest.mark.parametrize("index", [{}, {"weight_map": {}}, {"weight_map": 3}, {"weight_map": {"a": "../x"}}])
def test_load_refuses_an_index_of_other_files(tmp_path, index):
    path = write_encoder(tmp_path) / "model.safetensors.index.json"
    path.write_text(json.dumps(index))
    with pytest.raises(ValueError, match=r"index\.json: .*weight_map"):
        load_text_encoder(tmp_path)


def test_load_refuses_a_tokenizer_of_a_larger_vocabulary(tmp_path):
    path = write_encoder(tmp_path) / "tokenizer.json"
    path.write_text(path.read_text().replace(f'"left":{len(WORDS) - 1}', '"left":999').replace('"left": ', '"left": 9'))
    with pytest.raises(ValueError, match=r"tokenizer\.json: has token"):
        load_text_encoder(tmp_path)


def test_load_of_damaged_folders_works_or_names_the_fault(tmp_path):
    rng = random.Random(0)
    for number in range(40):
        folder = write_encoder(tmp_path / str(number))
        path = folder / rng.choice(["config.json", "tokenizer.json", "model.safetensors"])
        data = bytearray(path.read_bytes())
        place = rng.randrange(min(len(data), 3000))
        data = data[:place] if rng.random() < 0.3 else [*data[:place], rng.randrange(256), *data[place + 1 :]]
        path.write_bytes(bytes(data))
        try:
            features = load_text_encoder(folder)(["a road with two cars"])[0].features
        except ValueError as error:
            assert str(folder) in str(error) or "copy" in str(error), error
        else:
            assert np.isfinite(features).all()
