"""Pictures of every kind: read alike, or refused by name."""

from __future__ import annotations

import io
import random

import numpy as np
import pytest
from PIL import Image

from scjax.camera.photo import BACKGROUND, MAX_PIXELS, as_photo, photo_from_array, read_photo
from tests.factories.image_folders import picture

PIXELS = picture(24, 40)


def _saved(path, image, **options):
    image.save(path, **options)
    return read_photo(path).pixels


@pytest.mark.parametrize("suffix", ["png", "bmp", "ppm", "tiff", "webp"])
def test_read_photo_of_lossless_formats(tmp_path, suffix):
    options = {"lossless": True} if suffix == "webp" else {}
    np.testing.assert_array_equal(_saved(tmp_path / f"a.{suffix}", Image.fromarray(PIXELS), **options), PIXELS)


@pytest.mark.parametrize("mode", ["L", "1", "P", "CMYK", "YCbCr", "RGBA", "LA"])
def test_read_photo_of_every_mode(tmp_path, mode):
    suffix = {"CMYK": "jpg", "YCbCr": "jpg"}.get(mode, "png")
    pixels = _saved(tmp_path / f"a.{suffix}", Image.fromarray(PIXELS).convert(mode))
    assert pixels.shape == PIXELS.shape and pixels.dtype == np.uint8
    if mode != "1":  # black and white dots
        luma = np.array([0.299, 0.587, 0.114])
        assert np.abs(pixels @ luma - PIXELS @ luma).mean() < 12


def test_transparent_pixels_get_the_background(tmp_path):
    pixels = np.dstack([PIXELS, np.zeros(PIXELS.shape[:2], np.uint8)])
    pixels[:, :20, 3] = 255
    read = _saved(tmp_path / "a.png", Image.fromarray(pixels))
    np.testing.assert_array_equal(read[:, :20], PIXELS[:, :20])
    np.testing.assert_array_equal(read[:, 20:], np.broadcast_to(BACKGROUND, read[:, 20:].shape))
    palette = Image.fromarray(PIXELS).quantize(8)
    palette.info["transparency"] = bytes([0] * 8)
    assert _saved(tmp_path / "b.png", palette, transparency=bytes([0] * 8))[0, 0].tolist() == list(BACKGROUND)


def test_sixteen_bit_grays_become_eight_bit(tmp_path):
    gray = (np.arange(24 * 40).reshape(24, 40) * 68).astype(np.uint16)
    read = _saved(tmp_path / "a.png", Image.fromarray(gray))
    np.testing.assert_allclose(read[..., 0], gray / 257, atol=0.51)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_undone(tmp_path, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    inverse = {5: 5, 6: 8, 7: 7, 8: 6}.get(orientation, orientation)
    undo = {2: 0, 3: 3, 4: 1, 5: 5, 6: 4, 7: 6, 8: 2}  # numbers of Image.Transpose
    stored = Image.fromarray(PIXELS)
    if orientation > 1:
        stored = stored.transpose(Image.Transpose(undo[inverse]))
    np.testing.assert_array_equal(_saved(tmp_path / "a.png", stored, exif=exif), PIXELS)


def test_damaged_exif_turns_nothing(tmp_path):
    Image.fromarray(PIXELS).save(tmp_path / "a.png", exif=b"Exif\0\0II*\0\xff\xff\xff\xffrubbish")
    np.testing.assert_array_equal(read_photo(tmp_path / "a.png").pixels, PIXELS)


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (4320, 7680)])
def test_read_photo_of_any_size(tmp_path, size):
    Image.new("RGB", size[::-1], (1, 2, 3)).save(tmp_path / "a.png", compress_level=1)
    photo = read_photo(tmp_path / "a.png")
    assert photo.size == size and photo.pixels[-1, -1].tolist() == [1, 2, 3]


def _png(**changes):
    buffer = io.BytesIO()
    Image.fromarray(PIXELS).save(buffer, "png", **changes)
    return buffer.getvalue()


def _jpeg():
    buffer = io.BytesIO()
    Image.fromarray(picture(200, 300)).save(buffer, "jpeg")
    return buffer.getvalue()


def _tiff_of_floats():
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((4, 4), np.float32)).save(buffer, "tiff")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is empty"),
        (b"no picture", "no picture in a known format"),
        (_png()[:200], "cannot be decoded"),
        (_jpeg()[:1500], "cannot be decoded"),
        (_tiff_of_floats(), "floating-point"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "no picture in a known format"),
    ],
)
def test_read_photo_names_unusable_files(tmp_path, data, message):
    path = tmp_path / "a.png"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"a\.png: .*{message}.*: (copy|give)|a\.png: .*{message}"):
        read_photo(path)


def test_read_photo_names_missing_files_and_folders(tmp_path):
    for path in (tmp_path / "gone.png", tmp_path):
        with pytest.raises(ValueError, match="cannot be read"):
            read_photo(path)


def test_read_photo_refuses_pictures_that_fill_the_memory(tmp_path):
    side = int(MAX_PIXELS**0.5) + 1
    Image.new("1", (side, side)).save(tmp_path / "a.png")
    with pytest.raises(ValueError, match=r"a\.png: .*pixels"):
        read_photo(tmp_path / "a.png")


def test_read_photo_of_damaged_files_works_or_names_the_file(tmp_path):
    rng = random.Random(0)
    for number in range(60):
        data = bytearray(rng.choice([_png(), _jpeg()]))
        for _ in range(rng.randint(1, 3)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path = tmp_path / f"{number}.bin"
        path.write_bytes(data[: rng.randint(20, len(data))])
        try:
            pixels = read_photo(path).pixels
        except ValueError as error:
            assert str(path) in str(error)
        else:
            assert pixels.ndim == 3 and pixels.dtype == np.uint8


def test_photo_from_array_of_gray_and_alpha():
    np.testing.assert_array_equal(photo_from_array(PIXELS[..., 0]).pixels[..., 2], PIXELS[..., 0])
    clear = np.dstack([PIXELS, np.zeros(PIXELS.shape[:2], np.uint8)])
    assert photo_from_array(clear).pixels[3, 4].tolist() == list(BACKGROUND)
    assert photo_from_array(PIXELS).content != photo_from_array(PIXELS[::-1]).content


@pytest.mark.parametrize(
    "array", [PIXELS / 255, PIXELS[..., :2], np.zeros((0, 4, 3), np.uint8), PIXELS.astype(int), None, [[1, 2]]]
)
def test_as_photo_refuses_other_arrays(array):
    with pytest.raises(ValueError, match="an image must be uint8"):
        as_photo(array)
