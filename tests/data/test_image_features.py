"""Features of folders of pictures."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scjax.camera.photo import read_photo
from scjax.cli import main
from scjax.data.image_features import ImageStore, embed_images
from scjax.encoders.depth import load_depth_network
from scjax.encoders.depth_files import FileDepth
from scjax.encoders.preprocessing import WIDE, Preprocessing
from scjax.encoders.vision import load_image_encoder
from tests.factories.image_folders import write_network, write_pictures

SMALL = Preprocessing("small", 2, 3)


@pytest.fixture(scope="module")
def encoder_folder(tmp_path_factory):
    return write_network(tmp_path_factory.mktemp("encoder"))


@pytest.fixture(scope="module")
def encoder(encoder_folder):
    return load_image_encoder(encoder_folder)


@pytest.fixture
def pictures(tmp_path):
    return write_pictures(tmp_path / "pictures")


def _embed(pictures, out, encoder, **options):
    return embed_images(pictures, out, encoder, SMALL, progress=False, **options)


def test_embed_keeps_features_of_all_folders(pictures, tmp_path, encoder):
    report = _embed(pictures, tmp_path / "out", encoder)
    assert (report.computed, report.reused, report.skipped) == (3, 0, [])
    store = ImageStore(tmp_path / "out")
    assert store.files == ["0.png", "2.png", "more/1.png"]
    assert (store.encoder, store.width, tuple(store.grid)) == (encoder.name, 16, (2, 3))
    expected = encoder([read_photo(pictures / "more" / "1.png")], SMALL)[0].tokens
    np.testing.assert_allclose(store.image("more/1.png").tokens, expected, rtol=2e-3, atol=1e-3)
    assert store.depth("0.png") is None


def test_embed_continues(pictures, tmp_path, encoder):
    _embed(pictures, tmp_path / "out", encoder)
    write_pictures(pictures, 5)
    report = _embed(pictures, tmp_path / "out", encoder)
    assert (report.computed, report.reused) == (2, 3)
    assert len(ImageStore(tmp_path / "out").files) == 5


def test_embed_keeps_depth(pictures, tmp_path, encoder):
    network = load_depth_network(write_network(tmp_path / "depth", "depth_anything"), shorter_side=12)
    _embed(pictures, tmp_path / "out", encoder)
    report = _embed(pictures, tmp_path / "out", encoder, depth=network)
    assert (report.computed, report.reused) == (3, 0)
    depth = ImageStore(tmp_path / "out").depth("0.png")
    assert depth is not None and depth.tokens.shape == (6, 1)


def test_embed_leaves_out_what_cannot_be_read(pictures, tmp_path, encoder):
    (pictures / "more" / "bad.jpg").write_bytes(b"no picture")
    (pictures / "2.png").write_bytes((pictures / "2.png").read_bytes()[:200])
    report = _embed(pictures, tmp_path / "out", encoder)
    assert [one.file for one in report.skipped] == ["2.png", "more/bad.jpg"]
    assert "2.png: cannot be decoded" in report.skipped[0].reason
    assert ImageStore(tmp_path / "out").files == ["0.png", "more/1.png"]


def test_embed_leaves_out_pictures_with_damaged_depth(pictures, tmp_path, encoder):
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth" / "0.npy", np.ones((4, 4)))
    (tmp_path / "depth" / "2.npy").write_bytes(b"?")
    report = _embed(pictures, tmp_path / "out", encoder, depth=FileDepth(tmp_path / "depth", root=pictures))
    assert [one.file for one in report.skipped] == ["2.png"]
    store = ImageStore(tmp_path / "out")
    assert store.depth("0.png") is not None and store.depth("more/1.png") is None


def test_embed_names_folders_without_pictures(tmp_path, encoder):
    with pytest.raises(ValueError, match="no such folder"):
        _embed(tmp_path / "nowhere", tmp_path / "out", encoder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="holds no pictures"):
        _embed(tmp_path / "empty", tmp_path / "out", encoder)
    (tmp_path / "empty" / "a.png").touch()
    with pytest.raises(ValueError, match=r"no picture can be used; the first: a\.png: .* is empty"):
        _embed(tmp_path / "empty", tmp_path / "out", encoder)


def test_store_names_damage(pictures, tmp_path, encoder):
    with pytest.raises(ValueError, match=r"images\.json: cannot be read .*embed-images again"):
        ImageStore(tmp_path / "out")
    _embed(pictures, tmp_path / "out", encoder)
    store = ImageStore(tmp_path / "out")
    with pytest.raises(ValueError, match="is none of the 3 pictures"):
        store.image("gone.png")
    next((tmp_path / "out").rglob("*.safetensors")).write_bytes(b"")
    with pytest.raises(ValueError, match="missing or damaged"):
        for file in store.files:
            store.image(file)
    path = tmp_path / "out" / "images.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 99}))
    with pytest.raises(ValueError, match="has format 99"):
        ImageStore(tmp_path / "out")
    path.write_text("{")
    with pytest.raises(ValueError, match=r"images\.json is no JSON"):
        ImageStore(tmp_path / "out")


def _command(*arguments):
    with pytest.raises(SystemExit) as exit_info:
        main(["data", "embed-images", *map(str, arguments)])
    return int(exit_info.value.code or 0)


def test_command_embeds_and_continues(pictures, tmp_path, encoder_folder, capsys):
    depth = write_network(tmp_path / "depth", "depth_anything")
    options = ("--encoder", encoder_folder, "--depth", depth, "--depth-size", 12, "--preprocessing", "wide")
    assert _command(pictures, tmp_path / "out", *options) == 0
    assert "3 pictures embedded, 0 were already" in capsys.readouterr().out
    assert _command(pictures, tmp_path / "out", *options) == 0
    assert "0 pictures embedded, 3 were already" in capsys.readouterr().out
    assert tuple(ImageStore(tmp_path / "out").grid) == (WIDE.rows, WIDE.columns)


def test_command_counts_pictures_without_depth(pictures, tmp_path, encoder_folder, capsys):
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth" / "0.npy", np.ones((4, 4)))
    assert _command(pictures, tmp_path / "out", "--encoder", encoder_folder, "--depth", tmp_path / "depth") == 0
    assert "2 pictures have no depth in" in capsys.readouterr().err


def test_command_lists_skipped_pictures(pictures, tmp_path, encoder_folder, capsys):
    (pictures / "bad.png").write_bytes(b"?")
    assert _command(pictures, tmp_path / "out", "--encoder", encoder_folder) == 3
    assert "skipped bad.png: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--encoder", "no/where"), "hf download no/where"),
        (("--encoder", "ENCODER", "--inverse-depth"), "--inverse-depth is given without --depth"),
        (("--encoder", "ENCODER", "--depth", "no/where"), "depth network"),
        (("--encoder", "ENCODER", "--depth", "ENCODER"), "'dinov2' is not supported here: use depth_anything"),
    ],
)
def test_command_names_the_fault(pictures, tmp_path, encoder_folder, capsys, options, message):
    options = [str(encoder_folder) if one == "ENCODER" else one for one in options]
    assert _command(pictures, tmp_path / "out", *options) == 1
    error = capsys.readouterr().err
    assert message in error and len(error.splitlines()) == 1
