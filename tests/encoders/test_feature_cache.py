"""The cache of features: one entry for all that decides them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scjax.camera.photo import photo_from_array
from scjax.encoders.depth import ExactDepth
from scjax.encoders.feature_cache import FeatureCache, depth_key, image_key
from scjax.encoders.preprocessing import LETTERBOX, SQUASH, Preprocessing
from scjax.encoders.vision import GridTokens, load_image_encoder
from tests.factories.image_folders import picture, write_network

ROOT = Path(__file__).resolve().parents[2]
SMALL = Preprocessing("small", 2, 3)


class Counting:
    """An encoder that counts the pictures that it gets."""

    def __init__(self, encoder):
        self.encoder, self.pictures = encoder, 0
        self.name, self.key, self.width = encoder.name, encoder.key, encoder.width

    def __call__(self, photos, preprocessing):
        self.pictures += len(photos)
        return self.encoder(photos, preprocessing)


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    return load_image_encoder(write_network(tmp_path_factory.mktemp("encoder")))


@pytest.fixture
def counting(encoder):
    return Counting(encoder)


PHOTOS = [photo_from_array(picture(seed=seed)) for seed in range(3)]


def test_cache_computes_every_picture_once(tmp_path, counting):
    cache = FeatureCache(tmp_path)
    first = cache.image_tokens(counting, [*PHOTOS[:2], PHOTOS[0]], SMALL)
    assert counting.pictures == 2
    again = cache.image_tokens(counting, PHOTOS, SMALL)
    assert counting.pictures == 3
    np.testing.assert_array_equal(first[1].tokens, again[1].tokens)
    np.testing.assert_array_equal(first[0].tokens, first[2].tokens)
    assert again[0].grid == (2, 3) and again[0].mask.all()
    np.testing.assert_allclose(first[0].tokens, counting.encoder(PHOTOS[:1], SMALL)[0].tokens, rtol=2e-3, atol=1e-3)


def test_cache_keeps_depth(tmp_path):
    provider = ExactDepth(np.array([[1.0, 5], [3, 3]]))
    cache = FeatureCache(tmp_path)
    (first,), (again,) = (cache.depth_tokens(provider, PHOTOS[:1], SMALL) for _ in range(2))
    np.testing.assert_array_equal(first.tokens, again.tokens)
    assert first.tokens.shape == (6, 1) and len(list(tmp_path.rglob("*.safetensors"))) == 1


def test_keys_differ_with_content_encoder_and_preprocessing(tmp_path, encoder):
    other = load_image_encoder(write_network(tmp_path, "dinov3_vit"))
    rounded = load_image_encoder(tmp_path, compute="bfloat16")
    keys = {image_key(encoder, photo, SQUASH) for photo in PHOTOS}
    keys |= {image_key(encoder, PHOTOS[0], LETTERBOX)}
    keys |= {image_key(one, PHOTOS[0], SQUASH) for one in (other, rounded)}
    keys |= {depth_key(ExactDepth(np.full((2, 2), value)), PHOTOS[0], SQUASH) for value in (1.0, 2.0)}
    assert len(keys) == 8


@pytest.mark.parametrize("damage", [lambda data: data[:-3], lambda data: b"", lambda data: data[:-1] + b"\x7b"])
def test_damaged_entries_are_computed_again(tmp_path, counting, damage):
    cache = FeatureCache(tmp_path)
    (first,) = cache.image_tokens(counting, PHOTOS[:1], SMALL)
    path = cache.path(image_key(counting, PHOTOS[0], SMALL))
    path.write_bytes(damage(path.read_bytes()))
    (again,) = cache.image_tokens(counting, PHOTOS[:1], SMALL)
    assert counting.pictures == 2
    np.testing.assert_array_equal(first.tokens, again.tokens)


def test_numbers_that_float16_does_not_hold_are_refused(tmp_path):
    tokens = GridTokens(np.full((1, 2), 1e5, np.float32), np.ones(1, bool), (1, 1))
    with pytest.raises(ValueError, match="65504"):
        FeatureCache(tmp_path).write("ab", tokens)
    assert not list(tmp_path.rglob("*.*"))


_FILL = """
import sys
import numpy as np
from scjax.encoders.feature_cache import FeatureCache
from scjax.encoders.vision import GridTokens

cache = FeatureCache(sys.argv[1])
for turn in range(30):
    key = f"{turn % 5:02d}entry"
    tokens = GridTokens(np.full((6, 4), turn % 5, np.float32), np.ones(6, bool), (2, 3))
    cache.write(key, tokens)
    found = cache.read(key)
    assert found is not None and (found.tokens == turn % 5).all()
"""


def test_processes_share_a_cache(tmp_path):
    command = [sys.executable, "-c", _FILL, str(tmp_path)]
    processes = [subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    texts = [process.communicate()[1] for process in processes]
    assert [process.returncode for process in processes] == [0] * 2, texts
    assert len(list(tmp_path.rglob("*.safetensors"))) == 5 and not list(tmp_path.rglob("*.part"))
