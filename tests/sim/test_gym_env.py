"""Driving environments: Gymnasium's own checks, vector beside single ones, seeds, padding, rewards and errors."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from scjax.sim.constant_velocity import ConstantVelocity
from scjax.sim.drive import drive
from scjax.sim.gym import DrivingEnv, DrivingVectorEnv, Endings, RewardWeights
from scjax.sim.gym.spaces import boxed_observation, observation_space, policy_actions, unboxed_observation
from scjax.sim.observation import NUM_NEAREST, Observation
from scjax.sim.policies import RoutePolicy
from scjax.sim.route_follower import RouteFollower
from tests.factories.road_scenes import intersection, straight_road

KEEP_SPEED = ConstantVelocity()
FULL_SPEED = np.array([1.0, 0.0], np.float32)


def _road(gap=12.0, speed=8.0):
    """A straight road with the ego at 8 m/s and a vehicle ``gap`` [m] ahead."""
    builder = straight_road()
    builder.add_agent(gap, 0.0, speed=speed)
    return builder.scene()


def _env(sources, **options):
    return DrivingEnv(sources, **({"seconds": 3.0, "behavior": KEEP_SPEED} | options))


def _vector(sources, count, **options):
    return DrivingVectorEnv(sources, count, **({"seconds": 3.0, "behavior": KEEP_SPEED} | options))


def _terms(**values):
    names = ("progress", "collides", "off_road", "runs_red", "arrives", "acceleration", "lateral_acceleration")
    zeros = {name: np.zeros(1, np.float32 if name in names[:1] + names[5:] else bool) for name in names}
    return zeros | {name: np.array([value], zeros[name].dtype) for name, value in values.items()}


def test_env_passes_the_checks_of_gymnasium():
    spec = gymnasium.envs.registration.EnvSpec(
        "Driving-v0",
        entry_point=lambda **options: _env(_road(), **options),
        disable_env_checker=True,
        order_enforce=False,
    )
    check_env(gymnasium.make(spec, render_mode="rgb_array").unwrapped)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda mode: mode.value)
def test_vector_env_equals_single_ones(mode):
    sources = [_road(9.0, 0.0), _road(), intersection(12, 0, (0, 90, 180, -90)).scene()]
    options = {"seconds": 1.5, "behavior": RouteFollower()}
    vector = _vector(sources, 3, autoreset_mode=mode, **options)
    singles = SyncVectorEnv([lambda: _env(sources, **options)] * 3, autoreset_mode=mode)
    assert vector.metadata["autoreset_mode"] == singles.metadata["autoreset_mode"]
    assert vector.observation_space == singles.observation_space
    rng, ends = np.random.default_rng(0), 0
    results = (vector.reset(seed=7), singles.reset(seed=7))
    for _ in range(25):
        _assert_close(*results)
        actions = rng.uniform([0.0, -0.1], [1.0, 0.1], (3, 2)).astype(np.float32)
        results = (vector.step(actions), singles.step(actions))
        ends += int((results[0][2] | results[0][3]).sum())
    assert ends >= 4


def _assert_close(left, right):
    """Nested results are equal up to rounding, and of the same types."""
    assert type(left) is type(right)
    if isinstance(left, dict):
        assert left.keys() == right.keys()
        for name in left:
            _assert_close(left[name], right[name])
    elif isinstance(left, tuple) or (isinstance(left, np.ndarray) and left.dtype == object):
        for one, other in zip(left, right, strict=True):
            _assert_close(one, other)
    elif left is not None:
        assert np.asarray(left).dtype == np.asarray(right).dtype
        np.testing.assert_allclose(left, right, atol=2e-3)


def test_vector_env_restarts_what_reset_mask_says():
    env = _vector(_road(), 2, autoreset_mode=AutoresetMode.DISABLED, seconds=0.3)
    first, _ = env.reset(seed=0)
    for _ in range(3):
        _, _, _, truncated, _ = env.step(np.tile(FULL_SPEED, (2, 1)))
    assert truncated.all()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((2, 2)))
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((2, 2)))
    second, _ = env.reset(options={"reset_mask": np.array([False, True])})
    np.testing.assert_array_equal(second["speed"], first["speed"])


def test_env_drives_as_the_closed_loop_does():
    source, policy = _road(), RoutePolicy()
    env = _env(source, seconds=2.0)
    observation, info = env.reset(seed=3)
    closed = drive(jax.random.key(info["traffic_seed"]), source, policy, seconds=2.0, behavior=KEEP_SPEED)
    actions = jax.jit(lambda boxes: policy_actions(policy, boxes))
    progress = []
    for _ in range(20):
        action = np.asarray(actions({name: values[None] for name, values in observation.items()}))[0]
        observation, _, _, _, info = env.step(action)
        progress.append(info["progress"])
    np.testing.assert_allclose(progress, closed.terms["progress"], atol=1e-4)


def test_same_seed_gives_the_same_episode():
    env = _env([_road(), _road(20.0)])
    first, second = ([env.reset(seed=5), env.step(FULL_SPEED), env.reset()] for _ in range(2))
    assert data_equivalence(first, second, exact=True)


def test_episodes_draw_from_all_sources():
    env = _env([_road(), _road(20.0)])
    env.reset(seed=0)
    assert {env.reset()[1]["source"] for _ in range(12)} == {0, 1}
    assert env.reset(options={"source": 1})[1]["source"] == 1


def test_padding_changes_nothing():
    crowd = straight_road()
    for row in range(40):
        crowd.add_agent(-30.0 + row, 12.0)
    wide = _env([_road(), crowd.scene()])
    narrow = _env(_road())
    results = [env.reset(seed=1, options={"source": 0})[0] for env in (wide, narrow)]
    for _ in range(10):
        _assert_close(*results)
        results = [env.step(np.array([0.2, 0.0]))[:4] for env in (wide, narrow)]


@pytest.mark.parametrize("fault", [np.nan, np.inf])
def test_actions_that_are_not_finite_brake_and_are_reported(fault):
    env = _env(_road())
    observation, _ = env.reset(seed=0)
    after, reward, _, _, info = env.step(np.array([0.5, fault]))
    assert info["invalid_action"] and np.isfinite(reward)
    np.testing.assert_allclose(after["speed"], observation["speed"] - 0.3, atol=1e-4)
    assert not env.step(np.zeros(2))[4]["invalid_action"]


def test_actions_beyond_the_box_are_clipped():
    env, outcomes = _env(_road()), []
    for action in ([1.0, -1.0], [50.0, -50.0]):
        env.reset(seed=0)
        outcomes.append(env.step(np.array(action)))
    assert data_equivalence(*outcomes, exact=True)


def test_collision_ends_the_episode_unless_it_may_go_on():
    for endings, ends in ((Endings(), True), (Endings(collision=False), False)):
        env = _env(_road(8.0, 0.0), endings=endings)
        env.reset(seed=0)
        for _ in range(8):
            _, reward, terminated, _, info = env.step(FULL_SPEED)
            if info["collides"]:
                break
        assert info["collides"] and terminated == ends and reward < -4.0


def test_time_truncates_the_episode():
    env = _env(_road(), seconds=0.5)
    env.reset(seed=0)
    assert [env.step(np.zeros(2))[3] for _ in range(5)] == [False] * 4 + [True]


def test_reward_is_linear_in_its_weights():
    weights = RewardWeights(progress=2.0, collision=3.0, off_road=5.0, red_light=7.0, comfort=0.5, time=0.25)
    assert weights.reward(_terms(progress=1.5), 0.1).item() == pytest.approx(3.0 - 0.025)
    for name, cost in (("collides", 3.0), ("off_road", 5.0), ("runs_red", 7.0)):
        assert weights.reward(_terms(**{name: True}), 0.1).item() == pytest.approx(-cost - 0.025)
    rough = _terms(acceleration=-2.0, lateral_acceleration=1.0)
    assert weights.reward(rough, 0.1).item() == pytest.approx(-0.5 * 5.0 * 0.1 - 0.025)


def test_endings_are_what_they_say():
    assert Endings().terminated(_terms(arrives=True)).item()
    assert not Endings(arrival=False).terminated(_terms(arrives=True)).item()
    assert not Endings().terminated(_terms(runs_red=True)).item()
    assert Endings(red_light=True).terminated(_terms(runs_red=True)).item()


def test_boxes_keep_observations():
    space = observation_space()
    space.seed(0)
    sample = space.sample()
    observation = unboxed_observation(sample)
    again = boxed_observation(observation)
    assert data_equivalence(sample, {name: np.asarray(values) for name, values in again.items()})


def test_boxes_clip_what_is_far():
    nothing = Observation(
        speed=jnp.float32(400.0),
        size=jnp.ones(2),
        lateral=jnp.float32(-5e4),
        heading=jnp.float32(0.0),
        route=jnp.zeros((20, 3)),
        route_mask=jnp.zeros(20, bool),
        stop_distance=jnp.float32(1e9),
        agents=jnp.full((NUM_NEAREST, 7), 1e6),
        agent_types=jnp.zeros(NUM_NEAREST, jnp.int32),
        agent_mask=jnp.ones(NUM_NEAREST, bool),
    )
    boxes = {name: np.asarray(values) for name, values in boxed_observation(nothing).items()}
    assert boxes in observation_space()


def test_picture_shows_the_driven_agent_in_the_middle():
    env = _env(_road(), render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 480, 3)
    red, green, blue = picture[235:245, 235:245].reshape(-1, 3).mean(0)
    assert red > 150 and green < 110 and blue < 110


def test_source_whose_actor_is_off_the_road_is_refused():
    lost = straight_road()
    lost.add_agent(0.0, 25.0)
    with pytest.raises(ValueError, match=r"source 1: actor '0.agent-1' follows no lane"):
        _env([_road(), lost.scene()], actor="0.agent-1")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"sources": []}, "sources is empty"),
        ({"seconds": 0.0}, "seconds must be"),
        ({"actor": "nobody"}, "source 0: actor is 'nobody'"),
        ({"render_mode": "human"}, "render_mode is 'human'"),
    ],
)
def test_wrong_arguments_are_named(options, text):
    with pytest.raises(ValueError, match=text):
        _env(**({"sources": _road()} | options))


def test_weights_must_be_costs():
    with pytest.raises(ValueError, match="collision must be"):
        RewardWeights(collision=-1.0)


def test_wrong_calls_are_named():
    env = _env(_road())
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(FULL_SPEED)
    with pytest.raises(ValueError, match="source must be"):
        env.reset(options={"source": 1})
    env.reset()
    with pytest.raises(ValueError, match="action has shape"):
        env.step(np.zeros(3))


def test_gymnasium_is_imported_by_environments_only():
    code = (
        "import sys, scjax, scjax.sim.drive\n"
        "assert 'gymnasium' not in sys.modules\n"
        "sys.modules['gymnasium'] = None\n"
        "import scjax.sim.gym"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 1
    assert process.stderr.strip().endswith("pip install 'scjax[gym]'")
