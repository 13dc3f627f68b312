"""Depth tokens and where depth comes from."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from scjax.camera.photo import photo_from_array, read_photo
from scjax.encoders.depth import (
    FAR_RATIO,
    MAX_DEPTH,
    DepthProvider,
    ExactDepth,
    NoDepth,
    depth_tokens,
    from_inverse,
    load_depth_network,
)
from scjax.encoders.depth_files import FileDepth
from scjax.encoders.preprocessing import LETTERBOX, SQUASH, WIDE, Preprocessing
from tests.factories.image_folders import picture, write_network, write_pictures

PHOTO = photo_from_array(picture(90, 160))
TWO = Preprocessing("two", 2, 2)


def _tokens(depth, preprocessing=TWO, photo=PHOTO):
    (tokens,) = depth_tokens(ExactDepth(np.array(depth, np.float32)), [photo], preprocessing)
    return tokens


def test_depth_tokens_are_scaled_means():
    depth = np.repeat(np.repeat([[10, 20], [30, 50]], 3, 0), 5, 1)
    tokens = _tokens(depth)
    np.testing.assert_allclose(tokens.tokens[:, 0], [0, 0.25, 0.5, 1], atol=1e-6)
    assert tokens.tokens.shape == (4, 1) and tokens.mask.all()


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (45, 80), (3, 7)])
def test_depth_tokens_of_any_resolution(size):
    depth = np.linspace(1, 9, size[0] * size[1]).reshape(size)
    tokens = _tokens(depth, WIDE)
    assert tokens.tokens.shape == (350, 1) and tokens.mask.all()
    assert 0 <= tokens.tokens.min() and tokens.tokens.max() <= 1 + 1e-6


def test_depth_tokens_do_not_depend_on_the_unit():
    depth = np.random.default_rng(0).uniform(2, 9, (45, 80))
    np.testing.assert_allclose(_tokens(depth).tokens, _tokens(3 * depth + 1).tokens, atol=1e-5)


def test_unknown_depth_is_left_out():
    depth = np.repeat(np.repeat([[10.0, 20], [30, 50]], 4, 0), 4, 1)
    depth[:4, :4] = np.nan
    depth[4:, 4] = np.nan  # a quarter of a cell
    tokens = _tokens(depth)
    assert tokens.mask.tolist() == [False, True, True, True]
    np.testing.assert_allclose(tokens.tokens[:, 0], [0, 0, 1 / 3, 1], atol=1e-6)


def test_depth_of_the_sky_is_the_largest():
    tokens = _tokens([[np.inf, 40.0], [0.0, 100.0]])
    np.testing.assert_allclose(tokens.tokens[:, 0], [1, 40 / MAX_DEPTH, 0, 1], atol=1e-6)


@pytest.mark.parametrize("depth", [[[np.nan]], [[np.nan, np.nan]]])
def test_depth_of_nothing_known_is_masked(depth):
    tokens = _tokens(depth)
    assert not tokens.mask.any() and not tokens.tokens.any()


def test_constant_depth_is_zero():
    assert not _tokens([[7.0]]).tokens.any() and _tokens([[7.0]]).mask.all()


def test_no_depth_is_zero_and_masked():
    (tokens,) = depth_tokens(NoDepth(), [PHOTO], SQUASH)
    assert tokens.tokens.shape == (196, 1) and not tokens.tokens.any() and not tokens.mask.any()


def test_letterboxed_depth_has_the_mask_of_the_picture(tmp_path):
    tokens = _tokens(np.ones((9, 16)), LETTERBOX)
    assert tokens.mask.reshape(14, 14).sum(0).tolist() == [8] * 14


@pytest.mark.parametrize("depth", [np.zeros(3), np.zeros((0, 2)), np.full((2, 2), -1.0), np.zeros((2, 2), complex)])
def test_depth_of_another_kind_is_refused(depth):
    with pytest.raises(ValueError, match="depth"):
        ExactDepth(depth)


def test_inverse_depth_is_cut_at_the_far_ratio():
    np.testing.assert_allclose(from_inverse(np.array([[4.0, 2.0], [1e-9, 0.0]])), [[1, 2], [FAR_RATIO, FAR_RATIO]])
    assert (from_inverse(np.zeros((2, 3))) == FAR_RATIO).all()


def test_depth_network_covers_the_picture(tmp_path):
    network = load_depth_network(write_network(tmp_path, "depth_anything"), shorter_side=12)
    assert network.input_size((90, 160)) == (12, 20) and network.input_size((160, 90)) == (20, 12)
    assert network.input_size((1, 8000)) == (12, 48) and network.input_size((1, 1)) == (12, 12)
    depth = network(PHOTO)
    assert depth.shape == (12, 20) and 1 <= depth.min() and depth.max() <= FAR_RATIO
    (tokens,) = depth_tokens(network, [PHOTO], SQUASH)
    assert tokens.mask.all() and np.isfinite(tokens.tokens).all()


def test_providers_keep_the_protocol(tmp_path):
    network = load_depth_network(write_network(tmp_path, "depth_anything"), shorter_side=12)
    providers = [NoDepth(), ExactDepth(np.ones((2, 2))), FileDepth(tmp_path), network]
    assert all(isinstance(provider, DepthProvider) for provider in providers)
    assert ExactDepth(np.ones((2, 2))).key_of(PHOTO) != ExactDepth(np.ones((2, 3))).key_of(PHOTO)


DEPTH = np.random.default_rng(0).integers(256, 9000, (9, 16))


@pytest.fixture
def photo(tmp_path):
    return read_photo(write_pictures(tmp_path / "pictures") / "more" / "1.png")


@pytest.mark.parametrize("kind", ["npy", "npz", "release", "png"])
def test_file_depth_of_every_kind(tmp_path, photo, kind):
    folder = tmp_path / "depth"
    folder.mkdir()
    values = (DEPTH / 256).astype(np.float32)
    write = {
        "npy": lambda: np.save(folder / "1.npy", values),
        "npz": lambda: np.savez(folder / "1.npz", depth=values),
        "release": lambda: np.savez(folder / "1.npz", depths=values[None], other=values),
        "png": lambda: Image.fromarray(DEPTH.astype(np.uint16)).save(folder / "1.png"),
    }
    write[kind]()
    np.testing.assert_allclose(FileDepth(folder)(photo), values, atol=1e-6)
    expected = values.max() / values  # inverse depth of ours: the largest number is nearest
    np.testing.assert_allclose(FileDepth(folder, is_inverse=True)(photo), np.minimum(expected, FAR_RATIO), rtol=1e-5)


def test_file_depth_finds_files_of_folders(tmp_path, photo):
    (tmp_path / "depth" / "more").mkdir(parents=True)
    np.save(tmp_path / "depth" / "more" / "1.npy", DEPTH)
    assert FileDepth(tmp_path / "depth")(photo) is None
    provider = FileDepth(tmp_path / "depth", root=tmp_path / "pictures")
    assert provider(photo) is not None
    before = provider.key_of(photo)
    np.save(tmp_path / "depth" / "more" / "1.npy", DEPTH + 1)
    assert provider.key_of(photo) != before


def test_file_depth_of_zero_is_unknown(tmp_path, photo):
    Image.fromarray(np.array([[0, 512]], np.uint16)).save(tmp_path / "1.png")
    np.testing.assert_array_equal(FileDepth(tmp_path)(photo), [[np.nan, 2]])


def test_file_depth_names_damaged_files(tmp_path, photo):
    for name, data in [("1.npy", b"\x93NUMPY rubbish"), ("1.npz", b"PK"), ("1.png", b"\x89PNG")]:
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ValueError, match=rf"{name}: cannot be read as depth"):
            FileDepth(tmp_path)(photo)
        (tmp_path / name).unlink()
    np.save(tmp_path / "1.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"1\.npy: cannot be read as depth"):
        FileDepth(tmp_path)(photo)
    Image.fromarray(picture()).save(tmp_path / "1.png")
    (tmp_path / "1.npy").unlink()
    with pytest.raises(ValueError, match="picture in color"):
        FileDepth(tmp_path)(photo)


def test_file_depth_names_a_missing_folder(tmp_path):
    with pytest.raises(ValueError, match="no such folder of depth files"):
        FileDepth(tmp_path / "nowhere")
