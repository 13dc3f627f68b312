"""Training of behaviors: logs become arrays, steps resume exactly."""

from __future__ import annotations

import json
import shutil

import jax
import numpy as np
import pytest

from scjax.nn.functional import flatten
from scjax.scene import AgentType, save_log
from scjax.sim.behavior_weights import load_behavior
from scjax.synthetic.motion import world_logs
from scjax.train.configs import behavior
from scjax.train.loop import train
from scjax.train.motion.clearance_returns import HORIZON, clearance_returns, return_bins
from scjax.train.motion.rolls import NOISE, roll_tracks
from scjax.train.motion.tracks import tracks_of
from tests.factories.behaviors import SIZES, small_vocabulary
from tests.factories.logs import example_log


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for number, log in enumerate(world_logs(1, 1)[:2]):
        save_log(log, folder / f"{number}.npz")
    return folder


def _config(logs, cache):
    config = behavior.get_config("tiny")
    config.logs, config.cache, config.rolls = str(logs), str(cache), 1
    config.model = {name: getattr(SIZES, name) for name in config.model}
    config.batch.batch_size, config.batch.agents, config.batch.trained = 2, 16, 4
    config.steps, config.optimizer.warmup = 6, 2
    config.log_every = config.checkpoint_every = 3
    config.evaluate_every = 6
    return config


@pytest.fixture(scope="module")
def runs(logs, tmp_path_factory):
    """Folders of a run of six steps, and of one that continued after three."""
    folder = tmp_path_factory.mktemp("runs")
    train(_config(logs, folder / "cache"), folder / "whole")
    shutil.copytree(folder / "whole", folder / "resumed")  # as it was after step 3
    for later in ("checkpoints/step_6", "model"):
        shutil.rmtree(folder / "resumed" / later)
    train(_config(logs, folder / "cache"), folder / "resumed")
    return folder


def test_run_resumes_exactly(runs):
    whole, resumed = (load_behavior(runs / name / "model") for name in ("whole", "resumed"))
    for path, leaf in flatten(whole.params).items():
        np.testing.assert_array_equal(flatten(resumed.params)[path], leaf)
    assert whole == resumed


def test_run_reports_its_terms(runs):
    lines = [json.loads(line) for line in (runs / "whole" / "metrics.jsonl").read_text().splitlines()]
    train_lines = [line for line in lines if line["scope"] == "train"]
    assert [line["step"] for line in train_lines] == [3, 6]
    assert all(np.isfinite(line["nll"]) for line in lines)
    assert any(line["scope"] == "val" for line in lines)


def test_cache_of_other_logs_is_refused(runs, logs, tmp_path):
    config = _config(logs, runs / "cache")
    config.rolls = 2
    with pytest.raises(ValueError, match="other logs, sizes or rolls"):
        train(config, tmp_path / "run")


def test_folder_without_logs_is_refused(tmp_path):
    with pytest.raises(ValueError, match="has no logs"):
        train(_config(tmp_path, tmp_path / "cache"), tmp_path / "run")


def test_rolls_stay_near_their_tracks():
    log = example_log()
    tracks = tracks_of(log, np.random.default_rng(0))
    rolls = roll_tracks(jax.random.key(0), tracks, small_vocabulary(), SIZES.history)
    vehicles = tracks.kind == AgentType.VEHICLE
    apart = np.hypot(rolls.traffic.x - tracks.x, rolls.traffic.y - tracks.y)
    assert rolls.has_target[:-1, :2].all() and not rolls.has_target[-1].any()
    assert apart[:, :2].max() < 0.3
    assert np.asarray(tracks.lanes)[:, :2, 0].min() >= 0 and vehicles[:2].all()
    noisy = roll_tracks(jax.random.key(0), tracks, small_vocabulary(), SIZES.history, NOISE.replace(share=1.0))
    away = np.hypot(noisy.traffic.x - tracks.x, noisy.traffic.y - tracks.y)
    assert away[:, :2].max() > apart[:, :2].max()


def test_targets_lead_from_place_to_place():
    tracks = tracks_of(example_log(), np.random.default_rng(0))
    rolls = roll_tracks(jax.random.key(0), tracks, small_vocabulary(), SIZES.history)
    traffic, motion = rolls.traffic, rolls.target
    cos, sin = np.cos(traffic.heading), np.sin(traffic.heading)
    x = traffic.x + cos * motion[..., 0] - sin * motion[..., 1]
    there = rolls.has_target[:-1] & rolls.has_target[1:]
    np.testing.assert_allclose(x[:-1][there], traffic.x[1:][there], atol=1e-4)


def test_returns_are_the_least_room_ahead():
    steps = 2 * HORIZON
    x = np.zeros((steps, 2), np.float32)
    x[:, 1] = 20.0
    x[HORIZON + 3, 1] = 5.2  # 1.2 m between the nearest discs, at one step
    y, heading = np.zeros_like(x), np.zeros_like(x)
    valid, length, width = np.ones_like(x, bool), np.float32([4, 4]), np.float32([4 / 3, 4 / 3])
    bins = clearance_returns(x, y, heading, valid, length, width, 8)
    near = int(np.searchsorted(return_bins(8), 5.2 - 8 / 3 - 4 / 3, side="right"))
    assert (bins[3 : HORIZON + 4] == near).all()
    assert (bins[:3] == 7).all() and (bins[HORIZON + 4 :] == 7).all()
