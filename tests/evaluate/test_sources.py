"""Sources of scenes: any rows, pickling, and errors that name the missing file."""

import pickle

import numpy as np
import pytest

from scjax.evaluate.eval_tiles import EvaluationTiles
from scjax.evaluate.sources import ChosenRows, NpzScenes, open_source
from tests.factories.evaluations import SCENES


def test_npz_source_reads_any_rows(worlds):
    source = open_source(f"npz:{worlds}")
    assert len(source.clusters) == 8 and source.ego
    for loaded, saved in zip(source.read([3, 6, 3]), (SCENES[3], SCENES[6], SCENES[3]), strict=True):
        np.testing.assert_array_equal(loaded.agents, saved.agents)


def test_chosen_rows_survive_pickling(worlds):
    source = open_source(f"npz:{worlds}")
    copy = pickle.loads(pickle.dumps(ChosenRows(source, [6, 3])))
    np.testing.assert_array_equal(copy.read([1])[0].lanes, SCENES[3].lanes)
    assert copy.clusters == [source.clusters[6], source.clusters[3]]


def test_open_source_reads_the_ego_option(worlds):
    assert not open_source(f"npz:{worlds}#no-ego").ego


def test_fingerprint_depends_on_the_content(worlds):
    assert NpzScenes(str(worlds / "b0.npz")).fingerprint != open_source(f"npz:{worlds}").fingerprint


def test_tiles_pickle_without_their_arrays(eval_dir):
    tiles = EvaluationTiles(str(eval_dir / "tiles_peer_vehicle.npz"), "all")
    assert len(tiles.clusters) == 236 and tiles.ego
    assert len(pickle.dumps(tiles)) < 100_000
    copy = pickle.loads(pickle.dumps(tiles))
    np.testing.assert_array_equal(copy.read([5])[0].lanes, tiles.read([5])[0].lanes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("folder", "names no scenes: write records:"),
        ("npz:nowhere", "there is no .npz file"),
        ("tiles:nowhere.npz", "there is no such file"),
        ("records:nowhere", "manifest.json: not there"),
        ("records:nowhere#test", "write one of the splits"),
    ],
)
def test_open_source_names_what_is_missing(text, message):
    with pytest.raises(ValueError, match=message):
        open_source(text)
