"""Animations of logs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image

from scjax.scene import MapLane
from scjax.synthetic.motion import world_logs
from scjax.viz import animate


def test_animate_writes_a_frame_for_every_step(tmp_path):
    log = world_logs(3, 0)[0].select_steps(list(range(0, 101, 20)))
    animate(log, tmp_path / "log.gif")
    with Image.open(tmp_path / "log.gif") as image:
        assert image.n_frames == log.num_steps
        first = np.asarray(image.convert("RGB"))
        image.seek(image.n_frames - 1)
        assert (np.asarray(image.convert("RGB")) != first).any()


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


@pytest.mark.parametrize(
    "change, message",
    [({"path": "log.mp4"}, "ends in .gif"), ({"object_index": 10**6}, "object_index"), ({"steps": 1}, "one step")],
)
def test_animate_refuses_with_a_cure(change, message, tmp_path):
    log = world_logs(3, 0)[0].select_steps(list(range(change.pop("steps", 3))))
    path = tmp_path / change.pop("path", "log.gif")
    with pytest.raises(ValueError, match=message):
        animate(log, path, **change)
    assert not path.exists()
