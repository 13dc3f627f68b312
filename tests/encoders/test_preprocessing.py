"""Pictures on the grid of an encoder."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.camera.photo import photo_from_array
from scjax.encoders.preprocessing import (
    DEVIATION,
    LETTERBOX,
    MEAN,
    PREPROCESSINGS,
    SQUASH,
    WIDE,
    Preprocessing,
    cell_matrices,
    prepare_image,
)
from scjax.encoders.resize import resize_antialiased
from tests.factories.image_folders import picture


@pytest.mark.parametrize("size", [(900, 1600), (1, 1), (1, 500), (500, 1), (14, 14), (1080, 1920)])
@pytest.mark.parametrize("preprocessing", list(PREPROCESSINGS.values()), ids=lambda one: one.name)
def test_prepare_of_any_size(preprocessing, size):
    prepared = prepare_image(photo_from_array(np.full((*size, 3), 200, np.uint8)), preprocessing, 4)
    assert prepared.pixels.shape == (preprocessing.rows * 4, preprocessing.columns * 4, 3)
    white = (200 / 255 - np.array(MEAN)) / DEVIATION
    shown = np.abs(prepared.pixels - white).max(-1) < 1e-4
    assert prepared.mask.any() and shown.any()
    assert (prepared.pixels[~shown] == 0).all()


def test_official_squash_has_224_pixels():
    assert prepare_image(photo_from_array(picture()), SQUASH, 16).pixels.shape == (224, 224, 3)
    assert prepare_image(photo_from_array(picture()), WIDE, 14).pixels.shape == (196, 350, 3)


def test_letterbox_keeps_proportions_and_marks_the_border():
    prepared = prepare_image(photo_from_array(picture(900, 1600)), LETTERBOX, 16)
    assert prepared.mask.sum(0).tolist() == [8] * 14  # 14 cells x 9 / 16
    rows = np.flatnonzero((prepared.pixels != 0).any((1, 2)))
    assert (rows[0], rows[-1]) == (49, 174)
    assert prepare_image(photo_from_array(picture(900, 1600)), SQUASH, 16).mask.all()


def test_cell_matrices_share_every_pixel_once():
    for preprocessing in PREPROCESSINGS.values():
        by_row, by_column = cell_matrices(preprocessing, (90, 160), (45, 160))
        _, _, height, width = preprocessing.content((90, 160))
        np.testing.assert_allclose(by_row.sum(0), height / 45)
        np.testing.assert_allclose(by_column.sum(0), width / 160)


def test_resize_keeps_constants_and_means():
    image = picture(300, 500)
    assert np.abs(resize_antialiased(np.full((300, 500, 3), 77, np.uint8), 14, 9) - 77).max() < 1e-3
    assert np.abs(resize_antialiased(image, 30, 50).mean((0, 1)) - image.mean((0, 1))).max() < 1
    np.testing.assert_allclose(resize_antialiased(image, 300, 500), image, atol=1e-3)


@pytest.mark.parametrize("rows", [0, -1, 10_000])
def test_preprocessing_refuses_odd_grids(rows):
    with pytest.raises(ValueError, match=r"Preprocessing\.rows"):
        Preprocessing("mine", rows, 14)


def test_keys_differ_with_pixels():
    assert len({one.key for one in (SQUASH, LETTERBOX, WIDE, Preprocessing("x", 14, 13))}) == 4
    assert Preprocessing("other name", 14, 14).key == SQUASH.key
