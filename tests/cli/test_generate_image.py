"""scjax generate --image: scenes of a picture, what lies beside them, and one line for bad input."""

from __future__ import annotations

import dataclasses
import json

import jax
import numpy as np
import pytest
from PIL import Image

import scjax
from scjax.camera import pinhole, write_rig
from scjax.camera.rig import Rig
from scjax.cli.output import slug
from scjax.encoders import load_image_encoder
from scjax.generate.picture_networks import ENCODER_VARIABLE
from scjax.generate.readings import PromptReadings
from scjax.language.attributes.vector import feature_names
from scjax.scene import Crop
from scjax.scene.io import load_npz
from tests.factories.image_folders import picture, write_network
from tests.factories.pictures import picture_model
from tests.factories.worlds import tiny_model

PIXELS = picture(90, 160)
QUICK = ("--num-steps", 2, "--agents", 3, "--lanes", 4, "--best-of", 1, "--format", "npz")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with an encoder, a model that reads its features, and one that reads none."""
    folder = tmp_path_factory.mktemp("pictures")
    encoder = load_image_encoder(write_network(folder / "encoder"))
    scjax.save(picture_model(image_encoder=encoder.name), folder / "model")
    return folder


@pytest.fixture(autouse=True)
def files(folder, tmp_path, monkeypatch):
    """Pictures and cameras in the folder where commands run."""
    monkeypatch.setenv(ENCODER_VARIABLE, str(folder / "encoder"))
    Image.fromarray(PIXELS).save(tmp_path / "Road 1.png")
    front = pinhole("front", 320, 180, field_of_view=90.0)
    write_rig(Rig(name="one", cameras=(front,)), tmp_path / "rig.json")


@pytest.fixture
def generate(run, folder):
    def call(*words, model=None):
        return run("generate", "--model", model or folder / "model", *QUICK, *words)

    return call


def read(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def test_scene_and_view_lie_beside_each_other(generate, folder, tmp_path):
    code, out, err = generate("--image", "Road 1.png", "-n", 2, "--seed", 4, "--out", "made")
    assert code == 0 and "2 scenes" in err, err
    name = slug("Road 1")
    assert out.split() == [f"made/{name}-4-{k}{end}" for k in (0, 1) for end in (".npz", "-view.png")]
    scene = load_npz(tmp_path / f"made/{name}-4-0.npz")
    assert scene.crop == Crop.FORWARD and (scene.num_agents, scene.num_lanes) == (3, 4)
    height, width, _ = read(tmp_path / f"made/{name}-4-0-view.png").shape
    assert 2 < width / height < 3.2
    condition = scjax.Condition(image=tmp_path / "Road 1.png", num_agents=3, num_lanes=4)
    same = scjax.sample(
        jax.random.key(4), [condition], num_scenes=2, model=scjax.load(folder / "model"), num_steps=2, repair=True
    )
    np.testing.assert_allclose(scene.lanes, same[0].lanes, atol=1e-5)


def test_prompt_and_picture_name_the_files_and_both_count(generate, tmp_path, monkeypatch):
    def read_requests(conditions, reader=None):
        read = [dataclasses.replace(one, attributes={"layout": "T"}) if one.prompt else one for one in conditions]
        return PromptReadings(read, [[] for _ in read], [{} for _ in read])

    monkeypatch.setattr("scjax.generate.readings.read_requests", read_requests)
    code, out, err = generate("--image", "Road 1.png", "a T-junction", "--json")
    (result,) = json.loads(out)["scenes"]
    assert code == 0, err
    assert result["image"] == "Road 1.png" and result["prompt"] == "a T-junction"
    assert result["files"] == [f"{slug('Road 1')}-{slug('a T-junction')}-0-0{end}" for end in (".npz", "-view.png")]
    assert result["request"] == {"layout": "T"}
    assert generate("--image", "Road 1.png")[0] == 0
    alone, both = (load_npz(tmp_path / f"{name}-0-0.npz") for name in (slug("Road 1"), result["files"][0][:-8]))
    assert not np.allclose(alone.lanes, both.lanes, atol=1e-3)


def test_camera_draws_the_scene_into_the_picture(generate, tmp_path):
    assert generate("--image", "Road 1.png", "--out", "plain")[0] == 0
    for name, words in {"file": ("rig.json",), "one": ("rig.json", "--camera-name", "front")}.items():
        code, _, err = generate("--image", "Road 1.png", "--out", name, "--camera", *words)
        assert code == 0, err
    plain, drawn, same = (read(tmp_path / f"{name}/{slug('Road 1')}-0-0-view.png") for name in ("plain", "file", "one"))
    assert plain.shape == drawn.shape and (np.abs(plain - drawn).max(-1) > 30).any()
    np.testing.assert_array_equal(drawn, same)


def test_depth_of_a_file_is_read(generate, tmp_path):
    depth = np.linspace(60, 3, 45)[:, None].repeat(80, 1)
    np.save(tmp_path / "d.npy", depth)
    np.savez(tmp_path / "d.npz", depth=depth)
    Image.fromarray((depth * 256).astype(np.uint16)).save(tmp_path / "d.png")
    scenes = []
    for words in ((), ("--depth", "d.npy"), ("--depth", "d.npz"), ("--depth", "d.png")):
        assert generate("--image", "Road 1.png", *words)[0] == 0
        scenes.append(load_npz(tmp_path / f"{slug('Road 1')}-0-0.npz").lanes)
    assert not np.allclose(scenes[0], scenes[1], atol=1e-3)
    np.testing.assert_array_equal(scenes[1], scenes[2])
    np.testing.assert_allclose(scenes[1], scenes[3], atol=0.1)


def save_turned(path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.rot90(PIXELS)).save(path, exif=exif, quality=100)


SOURCES = {
    "one_pixel.png": lambda path: Image.new("RGB", (1, 1)).save(path),
    "line.png": lambda path: Image.new("RGB", (3000, 1)).save(path),
    "turned.png": save_turned,
    "gray.png": lambda path: Image.fromarray(PIXELS[..., 0]).save(path),
    "alpha.png": lambda path: Image.fromarray(np.dstack([PIXELS, PIXELS[..., :1]])).save(path),
    "large.jpg": lambda path: Image.fromarray(PIXELS).resize((7680, 4320)).save(path),
}


@pytest.mark.parametrize("name", SOURCES)
def test_pictures_of_any_kind_are_taken(name, generate, tmp_path):
    SOURCES[name](tmp_path / name)
    camera = () if name in ("one_pixel.png", "line.png") else ("--camera", "rig.json")
    code, out, err = generate("--image", name, *camera)
    assert code == 0, err
    assert read(tmp_path / out.split()[1]).shape[1] < 2500


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--image", "nowhere.png"), "scjax: nowhere.png: cannot be read"),
        (("--image", "rig.json"), "scjax: rig.json: is no picture in a known format"),
        (("--image", "cut.png"), "scjax: cut.png: cannot be decoded"),
        (("--image", "empty.png"), "scjax: empty.png: is empty"),
        (("--image", "Road 1.png", "--depth", "nowhere.npy"), "scjax: nowhere.npy: cannot be read as depth"),
        (("--image", "Road 1.png", "--depth", "Road 1.png"), "it is a picture in color, not of depths"),
        (("--image", "Road 1.png", "--camera", "mine"), "scjax: --camera is 'mine': there is no such file"),
        (("--image", "Road 1.png", "--camera", "waymo-front"), "scjax: --camera waymo-front: the camera 'front' takes"),
        (("--image", "Road 1.png", "--camera", "surround-6"), "say which took Road 1.png with --camera-name"),
        (("--image", "Road 1.png", "--camera", "surround-6", "--camera-name", "CAM_BACK"), "it looks 180 degrees away"),
        (("--image", "Road 1.png", "--camera", "rig.json", "--camera-name", "rear"), "has no camera 'rear'"),
        (("--image", "Road 1.png", ""), "scjax: Condition.prompt: "),
    ],
)
def test_bad_files_are_one_line(words, message, generate, tmp_path):
    (tmp_path / "cut.png").write_bytes((tmp_path / "Road 1.png").read_bytes()[:400])
    (tmp_path / "empty.png").touch()
    code, out, err = generate(*words)
    assert (code, out) == (1, "") and message in err and len(err.splitlines()) == 1, err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--image", "Road 1.png", "--prompts", "list.jsonl"), "--image and --prompts exclude each other"),
        (("a road", "--camera", "dashcam"), "--camera is given without --image"),
        (("a road", "--depth", "d.npy"), "--depth is given without --image"),
        (("--image", "Road 1.png", "--camera-name", "front"), "--camera-name is given without --camera"),
        ((), "give PROMPT, --image FILE, --prompts FILE or --no-prompt"),
        (("a road", "--no-prompt"), "--no-prompt excludes PROMPT and --prompts"),
    ],
)
def test_options_that_do_not_fit_are_wrong_usage(words, message, generate):
    code, out, err = generate(*words)
    assert (code, out) == (2, "") and message in err


def test_models_without_pictures_or_their_encoder_say_so(run, generate, folder, tmp_path, monkeypatch):
    scjax.save(dataclasses.replace(tiny_model(attributes=feature_names()), reads_prompts=True), tmp_path / "plain")
    code, out, err = run("generate", "--image", "Road 1.png", "--model", str(tmp_path / "plain"))
    assert (code, out) == (1, "") and len(err.splitlines()) == 1
    assert "this model reads attributes and no pictures" in err
    monkeypatch.setenv(ENCODER_VARIABLE, str(write_network(tmp_path / "other", "dinov3_vit")))
    code, out, err = generate("--image", "Road 1.png")
    assert (code, out) == (1, "") and len(err.splitlines()) == 1 and "the image encoder here is dinov3_vit-" in err
