"""Roll-outs by the learned behavior."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.scene import AgentType
from scjax.sim.behavior_weights import DEFAULT_BEHAVIOR, load_behavior
from scjax.sim.learned import LearnedBehavior, _halves, _safe_logits
from scjax.sim.preparation import prepare
from scjax.sim.rollout import roll_out, stack_records
from scjax.sim.simulate import simulate
from tests.factories.behaviors import small_weights
from tests.factories.logs import example_log

SECONDS = 2.0


@pytest.fixture(scope="module")
def behavior():
    """That of the package: smaller networks take as long to compile."""
    return LearnedBehavior(load_behavior())


@pytest.fixture(scope="module")
def rollout(behavior):
    return simulate(7, example_log(), seconds=SECONDS, behavior=behavior, step=5)


def test_same_key_gives_same_arrays(behavior, rollout):
    again = simulate(7, example_log(), seconds=SECONDS, behavior=behavior, step=5)
    other = simulate(8, example_log(), seconds=SECONDS, behavior=behavior, step=5)
    np.testing.assert_array_equal(again.positions, rollout.positions)
    assert not np.array_equal(other.positions, rollout.positions)


def test_equal_weights_are_one_behavior():
    behavior = LearnedBehavior(small_weights())
    assert behavior == LearnedBehavior(small_weights())
    assert hash(behavior) == hash(LearnedBehavior(small_weights()))
    assert behavior != LearnedBehavior(small_weights(seed=1))


def test_vehicles_move_on_from_where_they_are(rollout):
    start = example_log()
    np.testing.assert_allclose(rollout.positions[:2, 0], start.positions[:2, 5], atol=1e-3)
    moved = np.linalg.norm(np.diff(rollout.positions[:2, :, :2], axis=1), axis=-1)
    speed = np.linalg.norm(rollout.velocities[:2, 1:], axis=-1)
    np.testing.assert_allclose(moved, 0.1 * speed, atol=0.05)  # velocities leave drift to the side out
    assert speed.max() > 1


def test_parked_agents_stay(behavior):
    log = example_log()
    types = log.object_types.copy()
    types[2] = AgentType.STATIC
    out = simulate(0, dataclasses.replace(log, object_types=types), seconds=SECONDS, behavior=behavior, step=5)
    row = out.object_ids.index("pedestrian")
    assert np.ptp(out.positions[row, :, :2], axis=0).max() == 0


def test_other_time_steps_are_refused(behavior):
    start = prepare(example_log(), 5, np.random.default_rng(0))
    network, agents, places = (stack_records([one]) for one in (start.network, start.agents, start.places))
    keys, signals = jax.random.split(jax.random.key(0), 1), np.zeros((1, 2, 1), np.int32)
    with pytest.raises(ValueError, match=r"dt is 0\.2 s"):
        roll_out(keys, network, agents, places, signals, behavior=behavior, dt=0.2)


def test_halves_make_up_the_motion():
    rng = np.random.default_rng(0)
    base, motion = (jnp.asarray(rng.uniform(0, 1, (20, 3)) * [3, 0.1, 0.2], jnp.float32) for _ in range(2))
    first, rest = (np.asarray(part) for part in _halves(base, motion))
    cos, sin = np.cos(first[:, 2]), np.sin(first[:, 2])
    np.testing.assert_allclose(first[:, 0] + cos * rest[:, 0] - sin * rest[:, 1], motion[:, 0], atol=1e-6)
    np.testing.assert_allclose(first[:, 1] + sin * rest[:, 0] + cos * rest[:, 1], motion[:, 1], atol=1e-6)
    np.testing.assert_allclose(first[:, 2] + rest[:, 2], motion[:, 2], atol=1e-6)


def test_safe_motions_leave_room_to_stop():
    forward = jnp.broadcast_to(jnp.linspace(0.0, 4.0, 41)[None], (3, 41))
    gap, lead_speed = jnp.array([10.0, 10.0, jnp.inf]), jnp.array([0.0, 8.0, 0.0])
    allowed = np.isfinite(np.asarray(_safe_logits(jnp.zeros((3, 41)), forward, gap, lead_speed)))
    longest = np.where(allowed, np.asarray(forward), 0).max(1)
    speed, braking = longest[0] / 0.2, 6.0
    assert longest[0] + speed**2 / (2 * braking) <= 9.5 < longest[0] + 0.1 + (speed + 0.5) ** 2 / (2 * braking)
    assert longest[0] < longest[1]  # a leader that drives needs less room
    assert allowed[2].all()


def test_weights_are_read_as_written(tmp_path):
    weights = small_weights()
    assert load_behavior(weights.save(tmp_path / "behavior")) == weights


def test_damaged_weights_are_refused(tmp_path):
    folder = small_weights().save(tmp_path / "behavior")
    with pytest.raises(ValueError, match="no behavior"):
        load_behavior(tmp_path)
    broken = dataclasses.replace(small_weights(), vocabulary=np.full((3, 16, 3), np.nan, np.float32))
    with pytest.raises(ValueError, match="not finite"):
        broken.save(tmp_path / "other")
    file = folder / "weights.safetensors"
    file.write_bytes(file.read_bytes()[:-4] + b"abcd")
    with pytest.raises(ValueError, match=r"weights\.safetensors"):
        load_behavior(folder)


def test_behavior_of_the_package_drives(behavior):
    weights = behavior.weights
    assert weights.notes["data"].startswith("scjax's own synthetic worlds")
    assert sum(path.stat().st_size for path in DEFAULT_BEHAVIOR.iterdir()) < 8e6
    log = simulate(0, example_log(), seconds=SECONDS, behavior=behavior, step=5)
    speed = np.linalg.norm(log.velocities[:2], axis=-1)
    assert log.valid[:2].all() and (speed > 3).all() and (speed < 17).all()  # from 10 m/s on an empty road
    assert np.abs(log.positions[0, :, 1] - 200.0).max() < 1.5  # it keeps to its lane
