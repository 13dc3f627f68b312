from __future__ import annotations

import os
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.caption_features import TextStore, embed_captions
from scjax.data.captions import add_captions, captions_path, read_captions
from scjax.data.loader import LoaderConfig, training_batches
from scjax.models.codec import scjax
from scjax.scene import Crop
from scjax.scene.files import part_path
from scjax.synthetic.source import Worlds
from tests.factories.damage import damaged_bytes
from tests.factories.words import Words


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("texts")
    build_records(Worlds(3, 6), folder, BuildOptions(split_percent=30.0, files_per_shard=2))
    add_captions(folder, texts=3, progress=False)
    embed_captions(folder, Words(), progress=False)
    return folder


def test_text_store_holds_every_text(folder):
    for split in ("train", "val"):
        store = TextStore(folder, split)
        captions = list(read_captions(folder, split))
        assert len(store) == len(captions) and store.encoder == "words-1"
        for record, caption in enumerate(captions):
            texts = caption.texts
            for number, text in zip(store.texts_of(record), texts, strict=True):
                expected = np.stack([Words.word(word) for word in text.split()]).astype(np.float16)
                np.testing.assert_array_equal(store.features(int(number)), expected)


def test_embed_captions_skips_embedded_splits(folder):
    again = Words()
    embed_captions(folder, again, progress=False)
    assert again.calls == []


def test_embed_captions_single_split(folder, tmp_path):
    for path in (folder / "manifest.json", captions_path(folder, "train"), captions_path(folder, "val")):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert list(embed_captions(tmp_path, Words(), splits=("val",), progress=False)) == ["val"]
    assert len(TextStore(tmp_path, "val")) == len(list(read_captions(tmp_path, "val")))
    with pytest.raises(ValueError, match="is not there"):
        TextStore(tmp_path, "train")


def test_training_batches_carry_captions(folder):
    store = TextStore(folder, "train")
    config = LoaderConfig(batch_size=4, buckets=((61, 100),), text_slots=40, jitter_position=0.0)
    batches = training_batches(folder, scjax(), config, texts=store)
    texts = {store.features(k)[:40].tobytes() for record in range(len(store)) for k in map(int, store.texts_of(record))}
    for _ in range(4):
        batch = next(batches)
        assert batch.tokens.shape == (4, 40, store.width) and batch.tokens.dtype == np.float16
        for crop, tokens, mask in zip(batch.scene.crop, batch.tokens, batch.token_mask, strict=True):
            assert mask.any() == (crop != Crop.FORWARD)
            if mask.any():
                assert tokens[mask].tobytes() in texts
    state = batches.state()
    expected = next(batches)
    resumed = training_batches(folder, scjax(), config, texts=store)
    resumed.restore(state)
    np.testing.assert_array_equal(next(resumed).tokens, expected.tokens)


def test_batches_have_slots_for_the_longest_caption(folder):
    store = TextStore(folder, "train")
    longest = max(len(store.features(text)) for text in range(store.num_texts))
    assert longest <= store.slots(512) < longest + 16 and store.slots(512) % 16 == 0
    assert store.slots(longest - 1) == longest - 1
    config = LoaderConfig(batch_size=2, buckets=((61, 100),), text_slots=512)
    assert next(training_batches(folder, scjax(), config, texts=store)).tokens.shape[1] == store.slots(512)


def test_text_store_refuses_missing_and_stale_files(folder, tmp_path):
    with pytest.raises(ValueError, match=r"python -m scjax\.data embed"):
        TextStore(tmp_path, "train")
    with pytest.raises(ValueError, match="holds no captions"):
        embed_captions(tmp_path, Words(), progress=False)
    for path in [captions_path(folder, "val"), folder / "text-val.npz", folder / "text-val.bin"]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    assert len(TextStore(tmp_path, "val"))
    captions_path(tmp_path, "val").write_bytes(b"other captions")
    with pytest.raises(ValueError, match="other captions"):
        TextStore(tmp_path, "val")
    (tmp_path / "text-val.npz").write_bytes(b"PK\x03\x04 cut")
    with pytest.raises(ValueError, match="damaged"):
        TextStore(tmp_path, "val")


@pytest.fixture
def copy(folder, tmp_path):
    """A folder with the captions and features of the validation split, which may be damaged."""
    for name in ("manifest.json", captions_path(folder, "val").name, "text-val.npz", "text-val.bin"):
        shutil.copy(folder / name, tmp_path / name)
    return tmp_path


def _rewrite(folder, **changes):
    with np.load(folder / "text-val.npz") as index:
        arrays = {**index, **changes}
    np.savez(folder / "text-val.npz", **{name: value for name, value in arrays.items() if value is not None})


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"starts": np.array([0, 7, 3])}, "do not match their hash"),
        ({"texts": np.array(3)}, "do not match their hash"),
        ({"width": np.array(6)}, "do not match their hash"),
        ({"encoder": np.array("other")}, "do not match their hash"),
        ({"index": np.array("00")}, "do not match their hash"),
        ({"texts": np.array([0.5])}, "texts has the type float64"),
        ({"index": None}, r"lacks the arrays \['index'\]"),
        ({"encoder": None}, r"lacks the arrays \['encoder'\]"),
        ({"format": np.array(9)}, "has another format"),
    ],
)
def test_text_store_names_what_is_wrong_in_the_index(copy, changes, fault):
    _rewrite(copy, **changes)
    with pytest.raises(ValueError, match=rf"text-val.*{fault}.*scjax\.data embed"):
        TextStore(copy, "val")


def test_text_store_refuses_texts_of_other_records(copy):
    with np.load(copy / "text-val.npz") as index:
        texts = index["texts"].copy()
    texts[[0, -1]] = texts[[-1, 0]]
    _rewrite(copy, texts=texts)
    with pytest.raises(ValueError, match=r"text-val\.npz is damaged"):
        TextStore(copy, "val")


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(draw=st.data(), name=st.sampled_from(["text-val.npz", "text-val.bin"]))
def test_text_store_of_damaged_files(folder, copy, draw, name):
    expected = TextStore(folder, "val")
    for other in ("text-val.npz", "text-val.bin"):
        shutil.copy(folder / other, copy / other)
    data = (folder / name).read_bytes()
    (copy / name).write_bytes(damaged := draw.draw(damaged_bytes(data)))
    try:
        store = TextStore(copy, "val")
    except ValueError as error:
        assert str(copy / "text-val") in str(error) and "\n" not in str(error)
        return
    assert name == "text-val.npz" or damaged == data
    for text in range(expected.num_texts):
        np.testing.assert_array_equal(store.features(text), expected.features(text))


def test_text_store_refuses_features_that_are_cut(copy):
    (copy / "text-val.bin").write_bytes((copy / "text-val.bin").read_bytes()[:-2])
    with pytest.raises(ValueError, match=r"text-val\.bin has \d+ bytes"):
        TextStore(copy, "val")


def test_text_store_finds_changed_features(copy):
    data = np.fromfile(copy / "text-val.bin", np.float16)
    data[3] = np.nan
    data.tofile(copy / "text-val.bin")
    with pytest.raises(ValueError, match=r"text-val\.bin holds other bytes than were written"):
        TextStore(copy, "val")
    assert embed_captions(copy, Words(), progress=False)["val"] == TextStore(copy, "val").num_texts


class _BadWords(Words):
    """An encoder with damaged weights."""

    name = "words-2"

    def __init__(self, value):
        super().__init__()
        self.value = value

    def __call__(self, texts):
        return [text._replace(features=np.full_like(text.features, self.value)) for text in super().__call__(texts)]


@pytest.mark.parametrize("value", [np.nan, 1e6])
def test_embed_captions_refuses_features_that_are_not_finite(copy, value):
    with pytest.raises(ValueError, match=r"words-2 gives features of (['\"]).*\1 that are NaN or above"):
        embed_captions(copy, _BadWords(value), progress=False)
    assert TextStore(copy, "val").encoder == Words.name and not list(copy.glob(".*.part"))


def test_embed_captions_removes_parts_of_killed_runs(copy):
    """Also of a process whose number another one has today, and of earlier versions."""
    (copy / f".text-val.bin.{os.getpid()}.part").write_bytes(b"half of the features")
    part_path(copy / "text-train.bin").write_bytes(b"half of the features")
    embed_captions(copy, Words(), progress=False)
    assert not list(copy.glob(".*.part"))


def test_embed_captions_of_equal_captions_has_nothing_to_do(folder, copy):
    for path in folder.glob("*.arrayrecord"):
        shutil.copy(path, copy / path.name)
    add_captions(copy, texts=3, progress=False)
    unchanged, encoder = [], Words()
    embed_captions(copy, encoder, splits=("val",), progress=False, on_unchanged=unchanged.append)
    assert unchanged == ["val"] and not encoder.calls
