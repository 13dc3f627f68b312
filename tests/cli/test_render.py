"""scjax render: pictures, videos and poses of cameras, and one line where something is at fault."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from PIL import Image

from scjax.camera import CAMERA_PRESETS, preset_rig, write_rig
from scjax.cli.render import render_command
from scjax.scene import save_log, save_map
from scjax.scene.io import save_json
from tests.factories.camera_logs import level_rig
from tests.factories.examples import example_scene
from tests.factories.logs import example_log
from tests.factories.maps import two_tile_map


def pixels(path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image)


@pytest.fixture(autouse=True)
def files(run, tmp_path):
    """Files to draw, in the folder where commands run."""
    save_log(example_log(), tmp_path / "log.npz")
    save_map(two_tile_map(), tmp_path / "map.json")
    save_json(example_scene(0, agents=4, lanes=5), tmp_path / "scene.json")
    write_rig(level_rig(), tmp_path / "rig.json")


def test_render_draws_scenes_maps_and_logs(run, tmp_path):
    for name, *options in (("scene.json",), ("log.npz", "--frame", "3"), ("map.json", "--at", "10,0,0")):
        code, out, err = run("render", name, *options, "--camera", "rig.json", "--out", "view.png")
        assert (code, out.split()) == (0, ["view.png", "view.cameras.json"]), err
        assert pixels(tmp_path / "view.png").shape == (100, 200, 3)


def test_render_writes_every_camera_of_a_rig(run, tmp_path):
    code, out, _ = run("render", "log.npz", "--camera", "surround-7", "--size", "160x88", "--out", "out/v.png")
    assert code == 0 and len(out.split()) == 8
    poses = json.loads((tmp_path / "out/v.cameras.json").read_text())
    assert [camera["name"] for camera in poses["cameras"]] == [c.name for c in preset_rig("surround-7").cameras]
    assert np.shape(poses["cameras"][0]["rotations"]) == (1, 3, 3) and poses["steps"] == [0]
    assert pixels(tmp_path / "out/v-camera_rear_tele_30fov.png").shape == (88, 160, 3)


@pytest.mark.parametrize("name", ["clip.gif", "clip.mp4"])
def test_render_writes_videos(name, run, tmp_path):
    code, out, err = run("render", "log.npz", "--camera", "rig.json", "--actor", "1", "--video", "--out", name)
    assert (code, out.split()) == (0, [name, "clip.cameras.json"]), err
    assert "10 frames, 10 a second" in err
    assert (tmp_path / name).read_bytes()[4 * name.endswith("mp4") :].startswith((b"GIF89a", b"ftyp"))
    assert len(json.loads((tmp_path / "clip.cameras.json").read_text())["timestamps"]) == 10


def test_render_writes_buffers(run, tmp_path):
    code, out, _ = run("render", "log.npz", "--camera", "rig.json", "--frame", "5", "--buffers")
    assert code == 0 and "view.npz" in out.split()
    with np.load(tmp_path / "view.npz") as arrays:
        shapes = {name: arrays[name].shape for name in arrays}
    assert shapes == dict.fromkeys(("depth", "ids", "kinds"), (100, 200))


def test_render_draws_on_a_photograph(run, tmp_path):
    Image.new("L", (200, 100), 90).save(tmp_path / "photo.jpg")
    code, out, err = run("render", "log.npz", "--camera", "rig.json", "--photo", "photo.jpg", "--frame", "5")
    assert (code, out.split()) == (0, ["view.png"]), err
    picture = pixels(tmp_path / "view.png")
    assert abs(int(np.median(picture)) - 90) <= 2 and (np.abs(picture.astype(int) - 90).max(-1) > 40).any()


def test_render_finds_the_camera_of_a_photograph(run, tmp_path):
    camera = {
        "width": 64,
        "height": 32,
        "intrinsic": [[50.0, 0.0, 32.0], [0.0, 50.0, 16.0], [0.0, 0.0, 1.0]],
        "sensor_to_ego": {"translation": [1.5, 0.0, 1.5], "rotation_wxyz": [0.5, -0.5, 0.5, -0.5]},
        "ego_to_global": {"translation": [4995.0, 200.0, 10.0], "rotation_wxyz": [1.0, 0.0, 0.0, 0.0]},
    }
    sample = {"sensors": {name: camera | {"file": f"{name}.png"} for name in ("FRONT", "BACK")}}
    (tmp_path / "sample.json").write_text(json.dumps(sample))
    for name in ("FRONT", "other"):
        Image.new("RGB", (64, 32)).save(tmp_path / f"{name}.png")
    code, _, err = run("render", "log.npz", "--camera", "sample.json", "--photo", "FRONT.png")
    assert code == 0 and pixels(tmp_path / "view.png").any(), err
    code, _, err = run("render", "log.npz", "--camera", "sample.json", "--photo", "other.png")
    assert code == 1 and "say which took other.png with --only" in err


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["log.npz", "--camera", "gopro"], 1, "no preset of that name: choose from dashcam"),
        (["log.npz", "--camera", "map.json"], 1, "missing required field `sensors`"),
        (["log.npz", "--camera", "surround-6", "--only", "top"], 1, "has no camera 'top': name one of CAM_FRONT"),
        (["log.npz", "--palette", "neon"], 1, "palette must be one of scjax, cosmos, sc"),
        (["log.npz", "--actor", "9"], 1, "log.npz: actor is 9: give one of the 3 objects"),
        (["log.npz", "--actor", "2", "--frame", "0"], 1, "log.npz: step is 0, but the carrier"),
        (["log.npz", "--frame", "77"], 1, "log.npz: step is 77"),
        (["map.json"], 1, "map.json: there is no ego to carry the camera"),
        (["scene.json", "--video", "--out", "v.gif"], 1, "has 2 to 600 frames, and the carrier is there at 1 steps"),
        (["log.npz", "--photo", "absent.jpg"], 1, "absent.jpg: cannot be read"),
        (["absent.npz"], 1, "absent.npz: there is no such file"),
        (["log.npz", "--size", "wide"], 2, "'wide' is no size"),
        (["log.npz", "--out", "v.mp4"], 2, "--video writes .mp4 or .gif"),
        (["log.npz", "--video"], 2, "--video writes .mp4 or .gif files"),
        (["log.npz", "--video", "--frame", "1", "--out", "v.mp4"], 2, "are for pictures: leave --video out"),
        (["log.npz", "--at", "0,0", "--actor", "1"], 2, "say where the camera is: give one of them"),
        (["log.npz", "--scene", "1"], 2, "--scene is for files of scenes"),
    ],
)
def test_render_says_what_is_wrong_in_one_line(arguments, code, message, run, tmp_path):
    actual, _, err = run("render", *arguments)
    assert (actual, message in err) == (code, True), err
    assert code == 2 or len(err.splitlines()) == 1
    assert not (tmp_path / "view.png").exists()


def test_render_without_opencv_names_the_cure(run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "cv2", None)
    code, _, err = run("render", "log.npz")
    assert code == 1 and "pip install 'scjax[camera]'" in err


def test_help_lists_the_presets():
    assert all(name.removesuffix("-raw") in (render_command.help or "") for name in CAMERA_PRESETS)


def test_render_makes_dashcam_pictures(run, tmp_path):
    arguments = ("render", "log.npz", "--camera", "rig.json", "--dashcam", "dusk", "--seed", "3", "--buffers")
    code, out, err = run(*arguments, "--frame", "5")
    assert (code, out.split()) == (0, ["view.png", "view.npz", "view.cameras.json"]), err
    with np.load(tmp_path / "view.npz") as arrays:
        assert set(arrays) == {"depth", "ids", "classes"}
    assert pixels(tmp_path / "view.png").std() > 5
    assert run("render", "log.npz", "--camera", "rig.json", "--dashcam", "any", "--video", "--out", "v.mp4")[0] == 0
    assert "choose from clear" in run("render", "log.npz", "--dashcam", "snow")[2]
    assert run("render", "log.npz", "--dashcam", "fog", "--palette", "sc")[0] == 2
