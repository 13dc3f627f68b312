"""Worlds in motion: logs of the moments that the scenes are cut from."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.scene import NO_EGO, Log, load_log, save_log, validate_log
from scjax.synthetic.motion import SECONDS_AHEAD, SECONDS_BACK, STEP, world_logs
from scjax.synthetic.world import World, make_world

_WORLDS = range(8)
_SEED = 3


@pytest.fixture(scope="module")
def worlds() -> list[tuple[World, list[Log]]]:
    return [(make_world(_SEED, k), world_logs(_SEED, k)) for k in _WORLDS]


def test_logs_last_ten_seconds_at_ten_hertz(worlds):
    for world, logs in worlds:
        assert len(logs) == len(world.moments)
        for log in logs:
            validate_log(log)
            np.testing.assert_allclose(np.diff(log.timestamps), STEP)
            assert log.timestamps[0] == -SECONDS_BACK and log.timestamps[-1] == pytest.approx(SECONDS_AHEAD)


def test_logs_hold_the_agents_of_the_moments(worlds):
    num_agents = num_found = 0
    for world, logs in worlds:
        flip = np.array([1.0, -1.0 if world.mirrored else 1.0])
        for moment, log in zip(world.moments, logs, strict=True):
            step = round(SECONDS_BACK / STEP)
            places = log.positions[log.valid[:, step], step, :2]
            distance = np.linalg.norm((moment.positions * flip)[:, None] - places[None], axis=-1).min(1)
            num_agents, num_found = num_agents + len(distance), num_found + int((distance < 1e-6).sum())
    assert num_agents > 200 and num_found / num_agents > 0.85  # the others overlap something at another time


def test_objects_move_as_fast_as_their_velocities_say(worlds):
    errors = []
    for _, logs in worlds:
        for log in logs:
            both = log.valid[:, 1:] & log.valid[:, :-1]
            moved = np.linalg.norm(np.diff(log.positions[..., :2], axis=1), axis=-1) / STEP
            speed = np.linalg.norm(log.velocities, axis=-1)
            errors.append(np.abs(moved - (speed[:, 1:] + speed[:, :-1]) / 2)[both])
            assert moved[both].max() < 45.0
    assert np.mean(np.concatenate(errors) > 1.0) < 0.005


def test_ego_is_there_all_the_time(worlds):
    egos = [(log, log.ego_index) for _, logs in worlds for log in logs if log.ego_index != NO_EGO]
    assert len(egos) >= 6 and all(log.valid[ego].all() for log, ego in egos)


def test_logs_survive_their_file(worlds, tmp_path):
    log = worlds[0][1][0]
    save_log(log, tmp_path / "log.npz")
    np.testing.assert_array_equal(load_log(tmp_path / "log.npz").positions, log.positions)
