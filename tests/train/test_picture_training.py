"""From rendered pictures of records to a vision network, and to a denoiser that reads its features."""

from __future__ import annotations

import dataclasses
import shutil

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.camera.camera import pinhole
from scjax.camera.photo import BACKGROUND, photo_from_array
from scjax.camera.standard_view import STANDARD_SIZE, standard_view
from scjax.data.build import load_manifest
from scjax.data.image_features import embed_images
from scjax.data.measurements import measure_records
from scjax.encoders import load_image_encoder
from scjax.encoders.preprocessing import Preprocessing
from scjax.generate.conditions import Condition
from scjax.generate.image_streams import image_streams
from scjax.generate.outline_draw import draw_outline
from scjax.generate.scene_spec import specify_scene
from scjax.generate.seen_views import changed_views
from scjax.generate.view_draw import draw_view
from scjax.language.attributes.vector import feature_names
from scjax.models.codec import scjax as ours
from scjax.models.denoiser.kinds import LANE_DIGITS, agent_digits
from scjax.scene import Crop, validate
from scjax.synthetic.pictures import CELLS, read_rendered, render_records
from scjax.train.configs import vision
from scjax.train.loop import train
from scjax.train.picture_loader import PictureLoader, PictureLoaderConfig, cut_picture, mirrored
from tests.factories.image_folders import picture
from tests.factories.small_runs import get_config
from tests.factories.worlds import tiny_model

pytest.importorskip("cv2")
SMALL = {"stem": 8, "fine": 8, "fine_layers": 1, "hidden_size": 12, "layers": 1, "heads": 2, "features": 4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory, world_records):
    """Records with pictures and measured forward windows."""
    folder = tmp_path_factory.mktemp("pictures")
    shutil.copytree(world_records, folder / "records")
    render_records(folder / "records", folder / "pictures", progress=False)
    measure_records(folder / "records", crop=Crop.FORWARD, progress=False)
    return folder


def vision_config(folder, **changes):
    config = vision.get_config("tiny")
    config.pictures = str(folder / "pictures")
    config.model.update(SMALL)
    config.steps, config.optimizer.warmup, config.batch.batch_size = 2, 1, 2
    config.evaluate_every, config.checkpoint_every, config.log_every = 2, 1, 1
    config.update(changes)
    return config


@pytest.fixture(scope="module")
def trained(folder):
    train(vision_config(folder), folder / "vision")
    return folder / "vision" / "model"


def test_rendered_pictures_have_targets_and_are_kept(folder):
    pixels, targets = read_rendered(folder / "pictures", "train", 0)
    assert pixels.shape == (*STANDARD_SIZE[::-1], 3) and targets.depth.shape == CELLS
    assert (targets.lanes[..., -1] > 0).any() and (targets.depth > 1).all()
    assert render_records(folder / "records", folder / "pictures", progress=False) == 0


def test_mirror_twice_is_the_picture(folder):
    pixels, targets = read_rendered(folder / "pictures", "train", 1)
    flipped = mirrored(pixels, targets)
    assert not np.array_equal(flipped[0], pixels)
    again = mirrored(*flipped)
    np.testing.assert_array_equal(again[0], pixels)
    chex.assert_trees_all_equal(again[1], targets)


def test_cut_pictures_show_nothing_around_a_part(folder):
    pixels, targets = read_rendered(folder / "pictures", "train", 1)
    cut, left = cut_picture(pixels, targets, np.random.default_rng(4))
    shown = (cut != BACKGROUND).any(-1)
    assert 0.3 < shown.mean() < 1 and np.array_equal(cut[shown], pixels[shown])
    cells = shown.reshape(28, 8, 28, 8).mean((1, 3))
    assert not left.lanes[cells == 0].any() and not left.objects[cells == 0].any()
    np.testing.assert_array_equal(left.lanes[cells == 1], targets.lanes[cells == 1])


def test_loader_resumes_at_the_next_batch(folder):
    config = PictureLoaderConfig(batch_size=2, seed=3)
    loader = PictureLoader(folder / "pictures", "train", config)
    next(loader)
    state, following = loader.state(), next(loader)
    again = PictureLoader(folder / "pictures", "train", config)
    again.restore(state)
    chex.assert_trees_all_equal(next(again), following)


def test_vision_network_trains_and_loads(trained):
    encoder = load_image_encoder(trained)
    (tokens,) = encoder([np.full((90, 160, 3), 90, np.uint8)])
    assert tokens.tokens.shape == (196, encoder.width) and np.isfinite(tokens.tokens).all()


def test_pictures_that_are_not_there_are_named(folder, tmp_path):
    config = vision_config(folder, pictures=str(tmp_path))
    with pytest.raises(ValueError, match="holds no pictures of the split train"):
        train(config, tmp_path / "run")


@pytest.fixture(scope="module")
def denoiser_run(folder, trained):
    """A frozen tiny denoiser with attributes and kinds that learns to read the features of the pictures."""
    encoder = load_image_encoder(trained)
    embed_images(folder / "pictures", folder / "features", encoder, Preprocessing("squash", 14, 14), progress=False)
    domains = tuple(load_manifest(folder / "records")["domains"])
    kinds = {"agent_kinds": agent_digits(ours()), "lane_kinds": LANE_DIGITS}
    base = tiny_model(attributes=feature_names(), domains=len(domains), **kinds)
    scjax.save(dataclasses.replace(base, domains=domains, counts=None, reads_prompts=True), folder / "base")
    config = get_config("denoiser")
    config.records, config.autoencoder, config.init_from = str(folder / "records"), *[str(folder / "base")] * 2
    config.optimizer.schedule, config.attributes = "constant", True
    config.steps, config.checkpoint_every, config.picture_every, config.evaluate_every = 1, 1, 0, 0
    config.condition, config.images, config.image_depth = "image", str(folder / "features"), False
    config.freeze, config.batch.crops = True, (0.0, 0.0, 1.0)
    config.batch.batch_size = 3  # on one of two devices: to spread a step takes a fifth more of its compiler
    train(config, folder / "frozen")
    return scjax.load(folder / "base"), scjax.load(folder / "frozen" / "model"), encoder


def test_frozen_denoiser_keeps_all_but_what_reads_pictures(denoiser_run):
    base, model, encoder = denoiser_run
    kept = {path: leaf for path, leaf in jax.tree_util.tree_leaves_with_path(base.denoiser.params)}
    leaves = dict(jax.tree_util.tree_leaves_with_path(model.denoiser.params))
    for path, leaf in kept.items():
        np.testing.assert_array_equal(leaf, leaves[path])
    assert model.image_encoder == encoder.name and model.views is not None and model.domains == base.domains


def test_frozen_denoiser_samples_without_a_picture_as_before(denoiser_run):
    base, model, _ = denoiser_run
    condition = Condition(attributes={"vehicles": 3}, num_lanes=5, num_agents=4)
    scenes = [scjax.sample(jax.random.key(0), condition, model=one, num_steps=2) for one in (base, model)]
    chex.assert_trees_all_equal(scenes[0].to_dict(), scenes[1].to_dict())


def test_encoder_reads_the_standard_view_of_a_picture(denoiser_run):
    """The camera decides what it gets; the model reads no stream of the camera itself."""
    _, model, encoder = denoiser_run
    camera = pinhole("one", 320, 180, field_of_view=90.0, pitch=-4.0)
    photo = photo_from_array(picture(90, 160))
    known, assumed = image_streams([Condition(image=photo, camera=camera), Condition(image=photo)], model, encoder)
    for streams, view in ((known, standard_view(photo, camera)), (assumed, standard_view(photo))):
        np.testing.assert_allclose(streams["image"].tokens, encoder([view])[0].tokens, atol=1e-4)
        assert "camera" not in streams
    assert np.abs(known["image"].tokens - assumed["image"].tokens).max() > 0.1


def test_streams_have_changed_views_where_seen_agents_hold(denoiser_run):
    _, model, encoder = denoiser_run
    photo = photo_from_array(picture(90, 160))
    held, loose = image_streams([Condition(image=photo), Condition(image=photo, hold_seen=False)], model, encoder)
    views = encoder(changed_views(standard_view(photo)))
    np.testing.assert_allclose(held["image"].views, [view.tokens for view in views], atol=1e-4)
    np.testing.assert_array_equal(held["image"].tokens, loose["image"].tokens)
    (alone,) = image_streams([Condition(image=photo, hold_seen=False)], model, encoder)
    assert alone["image"].views is None


def test_picture_decides_the_outline(denoiser_run, folder):
    """Counts and kinds come from a window that looks like the picture; the scene is ahead of the ego."""
    _, model, encoder = denoiser_run
    pixels, _ = read_rendered(folder / "pictures", "val", 0)
    condition = Condition(image=np.ascontiguousarray(pixels), crop=Crop.FORWARD)
    (streams,) = image_streams([condition], model, encoder)
    spec = specify_scene(condition, streams, model)
    view = draw_view(np.random.default_rng(0), spec, model)
    outline = draw_outline(np.random.default_rng(0), spec, model, view)
    assert outline is not None and outline.num_lanes == len(outline.lanes) > 0
    seen = Condition(streams=streams, crop=Crop.FORWARD)
    scene = scjax.sample(jax.random.key(0), seen, model=model, num_steps=2)
    validate(scene)
    assert scene.crop.tolist() == [Crop.FORWARD]
