"""Animations of logs."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

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
