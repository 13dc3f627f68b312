"""Animations of logs."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest
from PIL import Image

from scjax.scene import MapLane, Signal
from scjax.synthetic.motion import world_logs
from scjax.viz import animate, frames_of
from scjax.viz.animation import frame_steps
from scjax.viz.bev import EGO, SIGNAL_COLORS
from scjax.viz.video_file import write_video
from tests.factories.logs import example_log


def color(text: str) -> np.ndarray:
    return np.array([int(text[k : k + 2], 16) for k in (1, 3, 5)])


def share_of(frame: np.ndarray, text: str) -> float:
    """Share of the pixels that have a color."""
    return float((np.abs(frame.astype(int) - color(text)).max(-1) < 3).mean())


@pytest.fixture(scope="module")
def world_log():
    return world_logs(3, 0)[0].select_steps(list(range(0, 101, 20)))


def test_animate_writes_a_frame_for_every_step(world_log, tmp_path):
    animate(world_log, tmp_path / "log.gif")
    with Image.open(tmp_path / "log.gif") as image:
        assert image.n_frames == world_log.num_steps
        assert image.info["duration"] == 2000
        first = np.asarray(image.convert("RGB"))
        image.seek(image.n_frames - 1)
        assert (np.asarray(image.convert("RGB")) != first).any()


def test_animate_writes_an_mp4_that_browsers_play(world_log, tmp_path):
    av = pytest.importorskip("av", reason="needs the extra video")
    calls = []
    animate(world_log, tmp_path / "log.mp4", size=128, progress=lambda done, total: calls.append((done, total)))
    data = (tmp_path / "log.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat"), "the index must come first"
    with av.open(str(tmp_path / "log.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    frames = list(frames_of(world_log, size=128))
    assert len(decoded) == len(frames) == world_log.num_steps
    assert np.abs(np.array(decoded).astype(int) - np.array(frames)).mean() < 4
    assert calls == [(k + 1, len(frames)) for k in range(len(frames))]


def test_gif_shows_colors_that_the_first_frame_lacks(tmp_path):
    plain = np.full((64, 64, 3), 250, np.uint8)
    signal = plain.copy()
    signal[:8, :8] = color(EGO)
    write_video([plain, signal], tmp_path / "clip.gif", 10.0, [EGO])
    with Image.open(tmp_path / "clip.gif") as image:
        image.seek(1)
        assert share_of(np.asarray(image.convert("RGB")), EGO) == 1 / 64


def test_animate_shows_sidewalks_paler_than_roads(tmp_path):
    darkness = []
    for lane_type in ("surface_street", "not_for_cars"):
        lane = MapLane("a", lane_type, np.array([[-60.0, 0.0, 0.0], [60.0, 0.0, 0.0]]))
        log = world_logs(3, 0)[0].select_steps([0, 50])
        log = dataclasses.replace(log, lanes=(lane,), valid=np.zeros_like(log.valid), ego_index=-1)
        animate(log, tmp_path / f"{lane_type}.gif")
        with Image.open(tmp_path / f"{lane_type}.gif") as image:
            darkness.append(int(np.asarray(image.convert("L"))[230:250].min()))
    assert darkness[0] < darkness[1] - 20


def test_frames_show_signals_as_stop_lines_of_their_state():
    log = example_log()
    frames = list(frames_of(log, radius=30.0))
    green, red = SIGNAL_COLORS[Signal.GO], SIGNAL_COLORS[Signal.STOP]
    assert share_of(frames[0], green) > 0 and share_of(frames[0], red) == 0
    assert share_of(frames[-1], red) > 0 and share_of(frames[-1], green) == 0
    assert share_of(frames[-1], red) < 0.01, "a line, not the whole lane"
    bare = dataclasses.replace(log, signal_positions=np.full((1, 3), np.nan))
    assert (list(frames_of(bare, radius=30.0))[-1] == frames[-1]).all(), "lane b starts at its stop point"


def test_followed_object_stays_in_the_middle():
    log = example_log()
    for index in (0, 1):
        frame = list(frames_of(log, object_index=index))[9]
        rows, columns = np.nonzero(np.abs(frame.astype(int) - color(EGO)).max(-1) < 3)
        assert abs(rows.mean() - 240) < 3 and abs(columns.mean() - 240) < 4


def test_heading_up_does_not_depend_on_the_direction_of_the_log():
    log = example_log()
    frame = list(frames_of(log, heading_up=True))[5]
    cos, sin = np.cos(2.0), np.sin(2.0)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    turned = dataclasses.replace(
        log,
        positions=np.nan_to_num(log.positions) @ turn,
        headings=log.headings + 2.0,
        velocities=log.velocities @ turn[:2, :2],
        signal_positions=np.nan_to_num(log.signal_positions) @ turn,
        lanes=tuple(dataclasses.replace(lane, points=np.nan_to_num(lane.points) @ turn) for lane in log.lanes),
    )
    other = list(frames_of(turned, heading_up=True))[5]
    assert np.abs(frame.astype(int) - other).mean() < 1.5
    assert np.abs(frame.astype(int) - list(frames_of(turned))[5]).mean() > 3


def test_frame_steps_keep_the_speed_of_the_log():
    log = example_log()
    assert frame_steps(log, 10.0).tolist() == list(range(10))
    assert frame_steps(log, 1000.0).tolist() == list(range(10))
    assert frame_steps(log, 5.0).tolist() == [0, 2, 4, 6, 8]
    assert frame_steps(log, 0.1).tolist() == [0, 9]


@pytest.mark.parametrize(
    "change, message",
    [
        ({"path": "log.avi"}, "ends in .gif or .mp4"),
        ({"object_index": 10**6}, "object_index"),
        ({"steps": 1}, "one step"),
        ({"radius": float("nan")}, "radius is nan"),
        ({"size": 481}, "size is 481"),
        ({"frames_per_second": 0.0}, "frames_per_second is 0"),
        ({"object_index": -1, "heading_up": True}, "give object_index"),
    ],
)
def test_animate_refuses_with_a_cure(change, message, tmp_path):
    log = world_logs(3, 0)[0].select_steps(list(range(change.pop("steps", 3))))
    path = tmp_path / change.pop("path", "log.gif")
    with pytest.raises(ValueError, match=message):
        animate(log, path, **change)
    assert not path.exists()


def test_animate_refuses_broken_logs(tmp_path):
    log = example_log()
    positions = log.positions.copy()
    positions[1, 3, 0] = np.nan
    with pytest.raises(ValueError, match="positions of object 1 at step 3"):
        animate(dataclasses.replace(log, positions=positions), tmp_path / "log.gif")
    valid = log.valid.copy()
    valid[1] = False
    with pytest.raises(ValueError, match="valid at no step"):
        animate(dataclasses.replace(log, valid=valid), tmp_path / "log.gif", object_index=1)
    assert not list(tmp_path.iterdir())


def test_animate_refuses_too_many_frames(tmp_path):
    log = example_log()
    sparse = dataclasses.replace(log, timestamps=np.linspace(0.0, 9000.0, 10))
    assert len(frame_steps(sparse)) == 10, "a log has no more frames than steps"
    repeated = np.arange(10).repeat(301)
    many = dataclasses.replace(
        log,
        timestamps=0.1 * np.arange(len(repeated)),
        **{name: getattr(log, name)[:, repeated] for name in ("valid", "positions", "headings", "velocities")},
        signal_states=log.signal_states[:, repeated],
    )
    with pytest.raises(ValueError, match="3009 frames are more than 3000"):
        animate(many, tmp_path / "log.mp4")
    with pytest.raises(ValueError, match=r"601 frames are more than a GIF may have, 600: write an .mp4"):
        animate(many[:601], tmp_path / "log.gif")
    assert not list(tmp_path.iterdir())


def test_animate_names_the_package_that_mp4_needs(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ValueError, match=r"pip install 'scjax\[video\]'"):
        animate(example_log(), tmp_path / "log.mp4")
