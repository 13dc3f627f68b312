"""Pictures and depth of conditions: checked, made into streams, and read by models that were trained on them."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.camera import Rig, pinhole, preset_rig
from scjax.camera.projection import project_points
from scjax.encoders import ExactDepth, NoDepth, load_image_encoder
from scjax.generate.conditions import Condition, Stream
from scjax.generate.encode import encode_conditions, network_inputs
from scjax.generate.image_streams import image_streams
from scjax.generate.model import load_model, save_model
from scjax.generate.picture_networks import ENCODER_VARIABLE
from scjax.language.attributes.vector import feature_names
from scjax.models.denoiser.config import ImageCondition, TextCondition
from scjax.models.denoiser.context import ImageFeatures
from scjax.outpainting.extend import open_condition
from scjax.scene import Crop
from tests.factories.image_folders import picture, write_network, write_pictures
from tests.factories.worlds import tiny_model

GRID = (4, 3)
AHEAD = {"num_lanes": 5, "num_agents": 4, "domain": 0, "crop": Crop.FORWARD}
FIRST, SECOND = picture(seed=0), picture(seed=1)
STREAMS = {
    "image": Stream.from_image(np.zeros((16, *GRID), np.float32)),
    "depth": Stream.from_depth(np.zeros(GRID, np.float32)),
}
DEPTH = np.linspace(60, 3, 45)[:, None].repeat(80, 1)


CAMERA = pinhole("front", 160, 90, field_of_view=90.0, position=(0.0, 0.0, 1.5))


def changed(**fields):
    return dataclasses.replace(CAMERA, **fields)


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    return load_image_encoder(write_network(tmp_path_factory.mktemp("encoder")))


@pytest.fixture(scope="module")
def model(encoder):
    return dataclasses.replace(tiny_model(ImageCondition(16, GRID, patch=1)), image_encoder=encoder.name)


@pytest.fixture
def streams_of(model, encoder):
    def make(*conditions, **changes):
        return image_streams(conditions, dataclasses.replace(model, **changes), encoder)

    return make


@pytest.fixture
def sample(model, encoder, monkeypatch):
    """Samples with the tiny encoder as the one that is found."""
    monkeypatch.setattr("scjax.generate.picture_networks.load_image_encoder", lambda source: encoder)

    def run(*conditions, **options):
        return scjax.sample(jax.random.key(0), list(conditions), model=model, num_steps=3, guidance=1.0, **options)

    return run


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"image": "nowhere.png"}, r"Condition\.image: nowhere\.png: cannot be read"),
        ({"image": FIRST / 255}, r"Condition\.image: an image must be uint8"),
        ({"depth": DEPTH}, r"Condition\.depth is given without an image"),
        ({"camera": CAMERA}, r"Condition\.camera is given without an image"),
        ({"image": FIRST, "camera": "mine"}, r"Condition\.camera: it must be a scjax\.camera\.Camera .* str"),
        (
            {"image": FIRST, "camera": changed(height=80)},
            r"Condition\.camera: the camera 'front' takes .* 160 x 80 pixels, .* 80 x 45",
        ),
        ({"image": FIRST, "camera": changed(rotation=np.eye(3))}, r"Condition\.camera: it looks 90 degrees away"),
        ({"image": FIRST, "camera": preset_rig("surround-6")}, r"Condition\.camera: rig 'surround-6' has 6 cameras"),
        ({"image": FIRST, "depth": -DEPTH}, r"Condition\.depth: .*negative"),
        ({"image": FIRST, "depth": "far"}, r"Condition\.depth: .*must be numbers"),
        ({"image": FIRST, "crop": Crop.CENTERED}, r"Condition\.image shows the road ahead .*Crop\.FORWARD"),
        ({"image": FIRST, "crop": "partitioned"}, r"the crop is PARTITIONED: leave crop out"),
        ({"image": FIRST, "streams": {"image": Stream(np.zeros((2, 3)))}}, r"streams\['image'\] and image are both"),
    ],
)
def test_condition_refuses_bad_pictures(fields, message):
    with pytest.raises(ValueError, match=message):
        Condition(**{"crop": Crop.FORWARD, **fields})


@pytest.mark.parametrize("fields", [{"image": FIRST}, {"streams": STREAMS}, {"image": FIRST, "crop": "forward"}])
def test_condition_with_a_picture_is_of_the_road_ahead(fields):
    condition = Condition(**fields)
    assert condition.crop is Crop.FORWARD and dataclasses.replace(condition, num_lanes=3).crop is Crop.FORWARD


def test_condition_without_a_picture_is_centered():
    for condition in (Condition(), Condition(prompt="a road"), Condition(streams={"text": Stream(np.zeros((2, 3)))})):
        assert condition.crop is Crop.CENTERED


def test_condition_reads_files_and_arrays(tmp_path):
    path = write_pictures(tmp_path, 1) / "0.png"
    condition = Condition(image=path, crop=Crop.FORWARD)
    np.testing.assert_array_equal(condition.image.pixels, FIRST)
    again = dataclasses.replace(condition, num_lanes=3)
    assert again.image is condition.image
    assert isinstance(Condition(image=FIRST, depth=DEPTH, crop=Crop.FORWARD).depth, ExactDepth)
    assert isinstance(Condition(image=FIRST, depth=NoDepth(), crop=Crop.FORWARD).depth, NoDepth)


def test_streams_have_tokens_masks_and_positions(streams_of):
    (streams,) = streams_of(Condition(image=FIRST, depth=DEPTH, crop=Crop.FORWARD))
    image, depth = streams["image"], streams["depth"]
    assert image.tokens.shape == (12, 16) and depth.tokens.shape == (12, 1)
    assert image.mask.all() and depth.mask.all()
    np.testing.assert_array_equal(image.positions, depth.positions)
    assert image.positions[4].tolist() == [1, 1]
    assert (np.diff(depth.tokens.reshape(GRID)[:, 0]) < 0).all()  # nearer further down


def test_streams_without_depth_mask_it(streams_of):
    (streams,) = streams_of(Condition(image=FIRST, crop=Crop.FORWARD))
    assert not streams["depth"].mask.any() and streams["image"].mask.all()


def test_streams_of_pictures_that_keep_their_proportions(streams_of):
    condition = Condition(image=FIRST, depth=DEPTH, crop=Crop.FORWARD)
    (streams,) = streams_of(condition, image_keeps_aspect=True)
    expected = [False, True, True, False]  # 45 x 80 pixels in four rows of three cells
    for stream in streams.values():
        assert stream.mask.reshape(GRID)[:, 0].tolist() == expected


def test_streams_have_the_rays_of_the_camera(streams_of):
    (streams,) = streams_of(Condition(image=FIRST, camera=CAMERA, crop=Crop.FORWARD))
    rays = streams["camera"].tokens.reshape(*GRID, 6)
    np.testing.assert_allclose(rays[..., 3:], np.broadcast_to([0, 0, 1.5], (*GRID, 3)))
    np.testing.assert_allclose(np.linalg.norm(rays[..., :3], axis=-1), 1, atol=1e-6)
    right, down = 160 / 3 / 80, 90 * 3 / 8 / 80  # of the middle of the last cell, at 1 m ahead
    np.testing.assert_allclose(
        rays[3, 2, :3], np.array([1, -right, -down]) / np.hypot(np.hypot(1, right), down), atol=1e-6
    )
    assert (np.diff(rays[:, 1, 2]) < 0).all() and (np.abs(rays[:, 1, 1]) < 1e-6).all()


def test_rays_of_a_lens_meet_the_middle_of_their_cell(streams_of):
    camera = dataclasses.replace(
        CAMERA, distortion=np.array([-0.1, 0.01, 0.001, 0.0, 0.0]), translation=np.array([0.2, 0.0, 1.5])
    )
    rig = Rig(name="one", cameras=(camera,), origin=np.array([-1.4, 0.0, 0.3]))
    (streams,) = streams_of(Condition(image=FIRST, camera=rig))
    tokens = streams["camera"].tokens.astype(np.float64)
    np.testing.assert_allclose(tokens[:, 3:], np.broadcast_to([-1.2, 0, 1.8], (12, 3)), atol=1e-6)
    pixels = project_points(camera, tokens[:, :3] @ camera.rotation).pixels
    rows, columns = np.indices(GRID).reshape(2, -1)
    expected = np.stack([(columns + 0.5) * 160 / 3 - 0.5, (rows + 0.5) * 90 / 4 - 0.5], -1)
    np.testing.assert_allclose(pixels, expected, atol=1e-3)


def test_cells_where_a_lens_shows_nothing_have_no_ray(streams_of):
    camera = dataclasses.replace(CAMERA, distortion=np.array([-0.9, 0.0, 0.0, 0.0, 0.0]))
    (streams,) = streams_of(Condition(image=FIRST, camera=camera))
    mask = streams["camera"].mask
    assert 0 < mask.sum() < 12 and (streams["camera"].tokens[~mask] == 0).all() and streams["image"].mask.all()


def test_rays_of_a_larger_picture_are_the_same(streams_of):
    small, large = (
        streams_of(Condition(image=picture(*size), camera=CAMERA, crop=Crop.FORWARD), image_keeps_aspect=True)[0]
        for size in ((45, 80), (180, 320))
    )
    np.testing.assert_allclose(small["camera"].tokens, large["camera"].tokens, atol=1e-6)
    assert (small["camera"].tokens[~small["camera"].mask] == 0).all()


def test_camera_that_is_not_read_is_said(model, encoder, monkeypatch):
    monkeypatch.setattr("scjax.generate.picture_networks.load_image_encoder", lambda source: encoder)
    with pytest.warns(UserWarning, match=r"Condition\.camera is not read by this model"):
        (streams,) = encode_conditions([Condition(image=FIRST, camera=CAMERA, crop=Crop.FORWARD)], model)
    assert streams.keys() == {"image", "depth"}


def test_streams_encode_every_picture_once(model, encoder):
    calls = []

    class Counting:
        name, key, width = encoder.name, encoder.key, encoder.width

        def __call__(self, images, preprocessing):
            calls.append(len(images))
            return encoder(images, preprocessing)

    pictures = [Condition(image=pixels, crop=Crop.FORWARD) for pixels in (FIRST, SECOND, FIRST)]
    streams = image_streams([*pictures, Condition()], model, Counting())
    assert calls == [2] and streams[3] == {}
    np.testing.assert_array_equal(streams[0]["image"].tokens, streams[2]["image"].tokens)


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (None, "this model reads no streams and no pictures: leave it out, or load"),
        (TextCondition(4), "this model reads text and no pictures"),
        (ImageCondition(16, GRID, patch=1), "reads features of no image encoder: give Condition.streams"),
    ],
)
def test_models_without_pictures_say_so(condition, message):
    with pytest.raises(ValueError, match=message):
        encode_conditions([Condition(image=FIRST, crop=Crop.FORWARD)], tiny_model(condition))


def test_a_model_without_pictures_says_so():
    condition = Condition(image=FIRST, crop=Crop.FORWARD)
    plain = tiny_model(attributes=feature_names())
    with pytest.raises(
        ValueError,
        match=r"Condition\.image is given, but this model reads attributes and no pictures: .*docs/images\.md",
    ):
        scjax.sample(jax.random.key(0), condition, model=plain)


def test_another_encoder_is_refused(model, tmp_path):
    other = load_image_encoder(write_network(tmp_path, "dinov3_vit"))
    expected = rf"trained with, {model.image_encoder}, .* here is {other.name}: .*SCJAX_IMAGE"
    with pytest.raises(ValueError, match=expected):
        image_streams([Condition(image=FIRST, crop=Crop.FORWARD)], model, other)


def test_absent_encoder_is_named(model, tmp_path, monkeypatch):
    monkeypatch.setenv(ENCODER_VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(ValueError, match="nowhere: no folder of an image encoder"):
        encode_conditions([Condition(image=FIRST, crop=Crop.FORWARD)], model)


def test_tiles_take_no_pictures():
    with pytest.raises(ValueError, match=r"Condition\.image is given, but tiles take prompts"):
        open_condition(Condition(image=FIRST, crop=Crop.FORWARD))


def test_model_folders_keep_the_image_encoder(model, tmp_path):
    changed = dataclasses.replace(model, image_keeps_aspect=True)
    loaded = load_model(save_model(changed, tmp_path / "model"))
    assert (loaded.image_encoder, loaded.image_keeps_aspect) == (model.image_encoder, True)


def test_picture_and_depth_change_the_scene(sample):
    fields = ({"image": FIRST}, {"image": SECOND}, {"image": FIRST, "depth": DEPTH})
    plain, other, deep = (sample(*[Condition(**one, **AHEAD)] * 2)[1] for one in fields)
    assert not np.allclose(plain.lanes, other.lanes) and not np.allclose(plain.lanes, deep.lanes)
    assert all(np.isfinite(scene.lanes).all() for scene in (plain, other, deep))


def test_picture_leaves_other_scenes_alone(sample):
    without, seen = Condition(**AHEAD), Condition(image=SECOND, **AHEAD)
    alone, among = sample(without, without)[0], sample(without, seen)[0]
    chex.assert_trees_all_close(alone.to_dict(), among.to_dict(), atol=2e-3)


def test_masked_cells_are_not_read(sample):
    rng = np.random.default_rng(0)
    mask = np.arange(12) % 3 > 0

    def condition(filling):
        tokens = np.where(mask[:, None], rng_tokens, filling).astype(np.float32)
        image = Stream(tokens, mask, np.indices(GRID).reshape(2, -1).T)
        depth = Stream(tokens[:, :1], mask, image.positions)
        return Condition(streams={"image": image, "depth": depth}, **AHEAD)

    rng_tokens = rng.normal(size=(12, 16))
    scenes = [sample(condition(filling), condition(filling))[0] for filling in (0.0, 5.0, np.nan)]
    chex.assert_trees_all_equal(scenes[0].to_dict(), scenes[1].to_dict(), scenes[2].to_dict())


def test_inputs_without_masks_stay_as_they_were(model):
    image = Stream.from_image(np.zeros((16, *GRID), np.float32))
    depth = Stream.from_depth(np.zeros(GRID, np.float32))
    features, _ = network_inputs([{"image": image, "depth": depth}], model.denoiser.config.condition)
    assert isinstance(features, ImageFeatures) and features.mask is None


def test_masked_depth_of_another_size_is_refused(sample):
    image = Stream.from_image(np.zeros((16, *GRID), np.float32))
    depth = dataclasses.replace(Stream.from_depth(np.zeros((8, 6), np.float32)), mask=np.ones(48, bool))
    with pytest.raises(ValueError, match=r"\['depth'\] has a mask of \(8, 6\) cells"):
        sample(Condition(streams={"image": image, "depth": depth}, **AHEAD))
