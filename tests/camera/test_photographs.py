"""Photographs of any mode and size become RGB; what is none is refused with the name of the file."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from scjax.camera.photographs import read_photograph


def save(path, array, mode=None, **options):
    image = Image.fromarray(array)
    (image.convert(mode) if mode else image).save(path, **options)
    return path


@pytest.mark.parametrize("mode", ["RGB", "L", "1", "P", "CMYK", "LA", "RGBA"])
def test_photographs_of_any_mode_become_rgb(mode, tmp_path):
    array = np.zeros((5, 7, 3), np.uint8)
    array[:, 3:] = 255
    path = save(tmp_path / ("p.jpg" if mode == "CMYK" else "p.png"), array, mode)
    picture = read_photograph(path)
    assert picture.shape == (5, 7, 3) and picture.dtype == np.uint8
    assert picture[2, 6].min() > 200 and picture[2, 0].max() < 50


def test_transparent_parts_are_black(tmp_path):
    array = np.full((4, 4, 4), 255, np.uint8)
    array[:2, :, 3] = 0
    picture = read_photograph(save(tmp_path / "p.png", array))
    assert not picture[:2].any() and (picture[2:] == 255).all()


def test_photographs_are_turned_as_their_camera_was(tmp_path):
    array = np.zeros((4, 6, 3), np.uint8)
    array[0, 0] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees
    picture = read_photograph(save(tmp_path / "p.png", array, exif=exif))
    assert picture.shape == (6, 4, 3) and (picture[0, 3] == 255).all()


def test_sixteen_bits_of_gray_keep_their_range(tmp_path):
    picture = read_photograph(save(tmp_path / "p.png", np.array([[0, 65535]], np.uint16)))
    assert picture[0, 0].max() == 0 and picture[0, 1].min() == 255


def test_one_pixel_is_a_photograph(tmp_path):
    assert read_photograph(save(tmp_path / "p.png", np.zeros((1, 1, 3), np.uint8))).shape == (1, 1, 3)


def test_files_that_are_no_photographs_are_refused(tmp_path):
    whole = save(tmp_path / "p.png", np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8))
    (tmp_path / "cut.png").write_bytes(whole.read_bytes()[:2000])
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").write_bytes(b"")
    for name in ("cut.png", "text.png", "empty.png", "absent.png"):
        with pytest.raises(ValueError, match=name):
            read_photograph(tmp_path / name)
    with pytest.raises(ValueError, match=r"give \[height, width"):
        read_photograph(np.zeros((4, 4, 2), np.uint8))
