"""Features that the ablation reads: rows of the road, in units of their spread."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.studies.ablation.road_features import write_road_features
from scjax.data.image_features import ImageStore
from scjax.data.window_images import StoredImages
from tests.factories.picture_features import FEATURE_GRID, FEATURE_WIDTH, save_features

ROWS, COLUMNS = FEATURE_GRID


@pytest.fixture
def folders(tmp_path):
    names = [f"train-{row:06d}" for row in range(40)] + ["val-000000"]
    written = save_features(tmp_path, names)
    write_road_features(tmp_path, tmp_path / "road", first_row=1)
    return tmp_path, written


def test_road_features_leave_out_the_rows_above(folders):
    folder, written = folders
    image = ImageStore(folder / "road").image("val-000000.jpg")
    assert image.grid == (ROWS - 1, COLUMNS) and image.tokens.shape == ((ROWS - 1) * COLUMNS, FEATURE_WIDTH)
    lower, kept = written["val-000000"][COLUMNS:-1, 2], image.tokens[:-1, 2]
    np.testing.assert_allclose(np.corrcoef(lower, kept)[0, 1], 1, atol=1e-5)


def test_road_features_are_standardized_over_training_pictures(folders):
    store = ImageStore(folders[0] / "road")
    images = [store.image(file) for file in store.files if file.startswith("train")]
    cells = np.concatenate([image.tokens[image.mask] for image in images])
    np.testing.assert_allclose(cells[:, :4].mean(0), 0, atol=2e-3)
    np.testing.assert_allclose(cells[:, :4].std(0), 1, atol=2e-3)
    assert np.abs(cells[:, 4]).max() < 1e-2  # always the same


def test_road_features_keep_masked_cells_at_zero(folders):
    image = ImageStore(folders[0] / "road").image("val-000000.jpg")
    assert not image.mask[-1] and not image.tokens[-1].any()


def test_road_features_have_an_encoder_of_their_own(folders):
    assert StoredImages(folders[0] / "road", "val").encoder != StoredImages(folders[0], "val").encoder


def test_road_features_need_training_pictures(tmp_path):
    save_features(tmp_path, ["val-000000"])
    with pytest.raises(ValueError, match="no pictures of training records"):
        write_road_features(tmp_path, tmp_path / "road", first_row=1)


def test_road_features_refuse_a_row_that_is_not_there(tmp_path):
    save_features(tmp_path, ["train-000000"])
    with pytest.raises(ValueError, match="rows 0 to 3"):
        write_road_features(tmp_path, tmp_path / "road", first_row=4)
