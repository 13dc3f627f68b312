from __future__ import annotations

import numpy as np
import pytest

from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.caption_features import TextStore, embed_captions
from scjax.data.captions import add_captions, captions_path, read_captions
from scjax.data.loader import LoaderConfig, training_batches
from scjax.models.codec import scjax
from scjax.scene import Crop
from scjax.synthetic.source import Worlds
from tests.factories.words import Words


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("texts")
    build_records(Worlds(3, 6), folder, BuildOptions(split_percent=30.0, files_per_shard=2))
    add_captions(folder, paraphrases=1, progress=False)
    embed_captions(folder, Words(), progress=False)
    return folder


def test_text_store_holds_every_text(folder):
    for split in ("train", "val"):
        store = TextStore(folder, split)
        captions = list(read_captions(folder, split))
        assert len(store) == len(captions) and store.encoder == "words-1"
        for record, caption in enumerate(captions):
            texts = [text for style in caption.texts.values() for text in style]
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
