"""BERT, T5 and UMT5 against the transformers library, on random tiny networks with every parameter drawn anew."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.encoders.minilm import MINILM
from scjax.encoders.package import cache_folder
from scjax.encoders.text import load_text_encoder

torch = pytest.importorskip("torch", reason="the parity extra (torch, transformers) is not installed")
transformers = pytest.importorskip("transformers", reason="the parity extra (torch, transformers) is not installed")
tokenizers = pytest.importorskip("tokenizers")

WORDS = ["[PAD]", "[UNK]", "a", "road", "with", "two", "lanes", "and", "three", "cars", "bend", "left"]
TEXTS = ["a road with two lanes", "a", "three cars and a bend left and a road with two lanes and three cars"]


def _bert():
    config = transformers.BertConfig(
        vocab_size=12,
        hidden_size=32,
        num_hidden_layers=3,
        num_attention_heads=4,
        intermediate_size=48,
        max_position_embeddings=40,
        type_vocab_size=2,
    )
    return transformers.BertModel(config), 1e-5


def _t5(kind: str, feed: str):
    cls, model = {
        "t5": (transformers.T5Config, transformers.T5EncoderModel),
        "umt5": (transformers.UMT5Config, transformers.UMT5EncoderModel),
    }[kind]
    config = cls(
        vocab_size=12,
        d_model=32,
        d_kv=8,
        d_ff=48,
        num_layers=3,
        num_heads=4,
        feed_forward_proj=feed,
        relative_attention_num_buckets=8,
        relative_attention_max_distance=12,
    )
    return model(config), 2e-5


MAKERS = {
    "bert": _bert,
    "umt5": lambda: _t5("umt5", "gated-gelu"),
    "t5 1.1": lambda: _t5("t5", "gated-gelu"),
    "t5": lambda: _t5("t5", "relu"),
}


def _saved(model, folder):
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.3 + 0.1 * (parameter.ndim == 1))
    model.eval().save_pretrained(folder)
    tokenizer = tokenizers.Tokenizer(tokenizers.models.WordLevel({w: i for i, w in enumerate(WORDS)}, "[UNK]"))
    tokenizer.pre_tokenizer = tokenizers.pre_tokenizers.Whitespace()
    tokenizer.save(str(folder / "tokenizer.json"))


def _theirs(model, ids: list[list[int]]) -> list[np.ndarray]:
    longest = max(map(len, ids))
    padded = torch.tensor([row + [0] * (longest - len(row)) for row in ids])
    mask = torch.tensor([[1] * len(row) + [0] * (longest - len(row)) for row in ids])
    with torch.no_grad():
        out = model(input_ids=padded, attention_mask=mask).last_hidden_state.numpy()
    return [out[row, : len(one)] for row, one in enumerate(ids)]


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("kind", list(MAKERS))
def test_parity_on_random_networks(kind, tmp_path):
    model, tolerance = MAKERS[kind]()
    _saved(model, tmp_path)
    encoder = load_text_encoder(tmp_path)
    ids = [[WORDS.index(word) for word in text.split()] for text in TEXTS]
    for ours, theirs in zip(encoder(TEXTS), _theirs(model, ids), strict=True):
        assert ours.features.shape == theirs.shape
        np.testing.assert_allclose(ours.features, theirs, rtol=tolerance, atol=tolerance * np.abs(theirs).max())


@pytest.mark.filterwarnings("default")
def test_parity_of_the_default_weights():
    folder = cache_folder() / MINILM.name
    if not all((folder / name).is_file() for name in MINILM.files):
        pytest.skip(f"{folder} is not there: call scjax.encoders.load_text_encoder() once")
    encoder = load_text_encoder(folder)
    model = transformers.BertModel.from_pretrained(folder).eval()
    texts = ["A busy four-way intersection with a red light.", "Rain!", "Two pedestrians cross; a bus waits. " * 6]
    ids = [encoder.tokenizer.encode(text.strip()).ids for text in texts]
    for ours, theirs in zip(encoder(texts), _theirs(model, ids), strict=True):
        np.testing.assert_allclose(ours.features, theirs, atol=1e-5, rtol=1e-4)
