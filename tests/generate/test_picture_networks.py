"""Image encoder and depth network of a model: the embedded ones where they are the model's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.encoders import NoDepth, load_depth_network, load_image_encoder
from scjax.generate.conditions import Condition
from scjax.generate.image_streams import image_streams
from scjax.generate.model import load_model, save_model
from scjax.generate.picture_networks import ENCODER_VARIABLE, default_depth, default_image_encoder
from scjax.models.denoiser.config import ImageCondition
from tests.factories.image_folders import CONFIGS, picture, write_network
from tests.factories.worlds import tiny_model

PHOTO = picture()

# Pictures are scaled to 518 pixels: attention between cells of 4 x 4 pixels takes 15 GB, of 28 x 28 next to nothing.
_COARSE_DEPTH = {
    **CONFIGS["depth_anything"],
    "backbone_config": {**CONFIGS["depth_anything"]["backbone_config"], "patch_size": 28, "image_size": 56},
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Folders of two encoders and a depth network."""
    folder = tmp_path_factory.mktemp("networks")
    return {
        "dinov2": write_network(folder / "dinov2"),
        "dinov3_vit": write_network(folder / "dinov3_vit", "dinov3_vit"),
        "depth_anything": write_network(folder / "depth_anything", "depth_anything", config=_COARSE_DEPTH),
    }


@pytest.fixture
def embed(folders, monkeypatch, tmp_path):
    """Makes a folder, or none, the embedded one; the cache of the hub is empty."""
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.delenv(ENCODER_VARIABLE, raising=False)

    def use(kind):
        folder = tmp_path / "nowhere" if kind is None else folders[kind]
        monkeypatch.setattr("scjax.generate.picture_networks.EMBEDDED_VISION", folder)

    return use


def model_of(folder, **changes):
    encoder = load_image_encoder(folder)
    return dataclasses.replace(tiny_model(ImageCondition(16, (4, 3), patch=1)), image_encoder=encoder.name, **changes)


def test_embedded_encoder_serves_its_model(embed, folders):
    embed("dinov2")
    model = model_of(folders["dinov2"])
    assert default_image_encoder(model).name == model.image_encoder
    (streams,) = image_streams([Condition(image=PHOTO)], model)
    assert streams["image"].tokens.shape == (12, 16) and not streams["depth"].mask.any()


def test_variable_comes_before_the_embedded_encoder(embed, folders, monkeypatch):
    embed("dinov2")
    monkeypatch.setenv(ENCODER_VARIABLE, str(folders["dinov3_vit"]))
    model = model_of(folders["dinov2"])
    with pytest.raises(ValueError, match=rf"trained with, {model.image_encoder}, .* encoder here is dinov3_vit-"):
        image_streams([Condition(image=PHOTO)], model)


@pytest.mark.parametrize("kind", [None, "depth_anything"])
def test_models_of_other_encoders_look_in_the_cache(embed, folders, kind):
    embed(kind)
    with pytest.raises(ValueError, match=r"facebook/dinov2-small: no folder of an image encoder"):
        default_image_encoder(model_of(folders["dinov2"]))


def test_embedded_encoder_with_other_weights_is_refused(embed, folders):
    embed("dinov2")
    model = dataclasses.replace(model_of(folders["dinov2"]), image_encoder="dinov2-0123456789ab")
    with pytest.raises(ValueError, match=r"trained with, dinov2-0123456789ab, but"):
        image_streams([Condition(image=PHOTO)], model)


def test_depth_that_is_not_given_is_estimated(embed, folders):
    embed("depth_anything")
    model, encoder = model_of(folders["dinov2"], estimates_depth=True), load_image_encoder(folders["dinov2"])
    network = load_depth_network(folders["depth_anything"])
    conditions = [
        Condition(image=PHOTO),
        Condition(image=PHOTO, depth=network),
        Condition(image=PHOTO, depth=NoDepth()),
    ]
    estimated, same, none = (streams["depth"] for streams in image_streams(conditions, model, encoder))
    assert estimated.mask.all() and not none.mask.any()
    np.testing.assert_array_equal(estimated.tokens, same.tokens)


def test_depth_is_not_estimated_for_models_that_saw_none(embed, folders):
    for kind, estimates in (("depth_anything", False), ("dinov2", True), (None, True)):
        embed(kind)
        assert isinstance(default_depth(model_of(folders["dinov2"], estimates_depth=estimates)), NoDepth)


def test_depth_of_one_picture_is_computed_once(embed, folders):
    embed(None)
    calls = []

    class Counting(NoDepth):
        def __call__(self, photo):
            calls.append(photo)

    depth = Counting()
    encoder = load_image_encoder(folders["dinov2"])
    image_streams([Condition(image=PHOTO, depth=depth)] * 3, model_of(folders["dinov2"]), encoder)
    assert len(calls) == 1


def test_model_folders_keep_whether_depth_is_estimated(folders, tmp_path):
    for value in (False, True):
        model = model_of(folders["dinov2"], estimates_depth=value)
        assert load_model(save_model(model, tmp_path / str(value))).estimates_depth is value
