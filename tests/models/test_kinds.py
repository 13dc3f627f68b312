"""Kinds of lanes and agents, and what the denoiser does with them."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.models import codec
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.kinds import LANE_DIGITS, NO_KIND, agent_digits, agent_kinds, digits_of, lane_kinds
from scjax.models.denoiser.model import denoiser
from scjax.scene import POINTS_PER_LANE, AgentType, Link, Signal, empty, pad
from scjax.scene.per_type import PerType

DIRECTION, TURN, SIGNAL, JOINTS, LEVEL, SIDE, LENGTH = range(len(LANE_DIGITS))
LARGE = len(codec.scjax().agent_types)
MOST = 12  # lanes and agents of every scene, padding included: one program for all


@jax.jit
def _all_lane_kinds(scene):
    return lane_kinds(scene)


@functools.partial(jax.jit, static_argnums=1)
def _all_agent_kinds(scene, own):
    return agent_kinds(scene, own)


def _lane_kinds(scene):
    return np.asarray(_all_lane_kinds(pad(scene, MOST, MOST)))[: len(scene.lane_mask)]


def _agent_kinds(scene, own):
    return np.asarray(_all_agent_kinds(pad(scene, MOST, MOST), own))[: len(scene.agent_mask)]


def _arc(start, heading, turn, length=20.0):
    headings = np.deg2rad(heading + np.linspace(0, turn, POINTS_PER_LANE - 1))
    steps = length / (POINTS_PER_LANE - 1) * np.stack([np.cos(headings), np.sin(headings)], 1)
    return np.concatenate([np.zeros((1, 2)), steps.cumsum(0)]) + np.asarray(start, float)


def _lanes(*arcs):
    scene = empty(1, len(arcs))
    scene.lanes[..., :2] = [_arc(*arc) for arc in arcs]
    scene.lane_mask[:] = True
    scene.agents[0, 4] = 1.0
    return scene


def _digit(scene, digit):
    return digits_of(_lane_kinds(scene), LANE_DIGITS)[digit].tolist()


def _agents():
    scene = empty(5, 1)
    scene.lanes[0, :, 0] = np.linspace(-30, 30, POINTS_PER_LANE)
    scene.lane_mask[:] = True
    scene.agents[:, 6] = (4.5, 12.0, 0.5, 9.0, 1.8)
    scene.agents[:, 4] = 1.0
    scene.agent_types[:] = [
        AgentType.VEHICLE,
        AgentType.VEHICLE,
        AgentType.PEDESTRIAN,
        AgentType.STATIC,
        AgentType.CYCLIST,
    ]
    scene.agent_mask[:] = True
    return scene


@pytest.mark.parametrize(
    ("heading", "expected"), [(0, 0), (20, 0), (-20, 0), (40, 1), (90, 2), (180, 4), (-170, 4), (-90, 6)]
)
def test_direction_of_a_lane_is_that_of_its_start(heading, expected):
    assert _digit(_lanes(((0, 0), heading, 80)), DIRECTION) == [expected]


def test_turns_of_lanes_are_one_of_nine_classes():
    turns = (-90, -40, -20, -8, 0, 8, 20, 40, 90, 180)
    assert _digit(_lanes(*[((0, 0), 170, turn) for turn in turns]), TURN) == [*range(9), 8]


def test_signals_and_levels_of_lanes():
    scene = _lanes(*[((0, 0), 0, 0)] * 3)
    scene.signals[:] = (Signal.UNKNOWN, Signal.GO, Signal.STOP)
    scene.lanes[1, :, 2], scene.lanes[2, :, 2] = 5.0, -5.0
    assert _digit(scene, SIGNAL) == [Signal.UNKNOWN, Signal.GO, Signal.STOP]
    assert _digit(scene, LEVEL) == [0, 1, 2]


def test_joints_of_lanes():
    """Lane 0 splits into 1 and 2, which merge into 3; 4 ends inside."""
    scene = _lanes(*[((0, 0), 0, 0)] * 3, ((12, 0), 0, 0), ((-10, 9), 0, 0))
    for before, after in ((0, 1), (0, 2), (1, 3), (2, 3)):
        scene.links[before, after], scene.links[after, before] = Link.PREDECESSOR, Link.SUCCESSOR
    assert _digit(scene, JOINTS) == [1, 0, 0, 2, 4]


def test_lanes_are_below_the_ego_or_abreast_of_it():
    scene = _lanes(*[((-10, y), 0, 0) for y in (0.5, 4.0, -4.0, 20.0)], ((10, 4), 0, 0), ((30, 4), 180, 0, 60))
    assert _digit(scene, SIDE) == [1, 2, 3, 0, 0, 2]


def test_lengths_of_lanes():
    assert _digit(_lanes(*[((0, 0), 0, 80, length) for length in (5, 15, 40)]), LENGTH) == [0, 1, 2]


def test_agents_have_classes_and_large_vehicles_are_one():
    own = codec.scjax()
    classes = [own.agent_types.index(one) for one in _agents().agent_types]
    classes[1] = LARGE
    assert digits_of(_agent_kinds(_agents(), own), agent_digits(own))[0].tolist() == classes


def test_agents_have_speeds_and_directions_and_are_on_lanes():
    scene = _agents()
    scene.agents[1:, 3] = (0.2, 1.0, 5.0, 15.0)
    scene.agents[2, 4:6] = (0.0, -1.0)
    scene.agents[3:, 1] = (1.6, 1.2)
    scene.agents[4, 4] = -1.0
    own = codec.scjax()
    _, speed, direction, on_lane, *_ = digits_of(_agent_kinds(scene, own), agent_digits(own))
    assert speed.tolist() == [0, 0, 1, 2, 3]
    assert direction.tolist() == [0, 0, 6, 0, 4]
    assert on_lane.tolist() == [1, 1, 2, 0, 3]


def test_agents_are_near_or_far_from_the_ego():
    scene, own = _agents(), codec.scjax()
    scene.agents[:, 0] = (5.0, 14.0, -4.0, 16.0, 40.0)
    assert digits_of(_agent_kinds(scene, own), agent_digits(own))[-1].tolist() == [0, 0, 0, 1, 2]


@pytest.mark.parametrize("heading", [0.0, 120.0])
def test_agents_are_ahead_behind_left_or_right_of_the_ego(heading):
    scene, own = _agents(), codec.scjax()
    places = np.array([(0, 0), (9, 1), (-9, -1), (20, 4), (-20, -4)], float)
    cos, sin = np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading))
    scene.agents[:, :2] = places @ np.array([[cos, sin], [-sin, cos]]) + 3.0
    scene.agents[:, 4:6] = (cos, sin)
    assert digits_of(_agent_kinds(scene, own), agent_digits(own))[-2].tolist()[1:] == [1, 2, 3, 4]
    scene.agents[1, :2] += 50.0
    assert digits_of(_agent_kinds(scene, own), agent_digits(own))[-2].tolist()[1] == 0


def test_padding_has_no_kind_and_changes_none():
    own, scene = codec.scjax(), _agents()
    padded = pad(scene, 7, 3)
    expected = [*_all_agent_kinds(scene, own).tolist(), NO_KIND, NO_KIND]
    assert _all_agent_kinds(padded, own).tolist() == expected
    assert _all_lane_kinds(padded).tolist() == [*_all_lane_kinds(scene).tolist(), NO_KIND, NO_KIND]


def test_classes_that_a_codec_lacks_have_no_kind():
    own = dataclasses.replace(codec.scjax(), agent_types=(AgentType.VEHICLE,), sizes=codec.scjax().sizes[:1])
    kinds = _agent_kinds(_agents(), own)
    assert (kinds >= 0).tolist() == [True, True, False, False, False]


def test_a_kind_changes_its_scene_alone_and_none_changes_nothing():
    sizes = {"lane_width": 16, "lane_heads": 2, "agent_width": 8, "agent_heads": 2, "blocks": 1, "mlp_ratio": 2}
    network = denoiser(DenoiserConfig(agent_kinds=(3, 2), lane_kinds=(2,), **sizes))
    leaves, tree = jax.tree.flatten(jax.device_get(network.init(jax.random.key(0))))
    noise = [0.2 * np.random.default_rng(i).normal(size=leaf.shape) for i, leaf in enumerate(leaves)]
    params = jax.tree.unflatten(tree, [jnp.asarray(x + y, jnp.float32) for x, y in zip(leaves, noise, strict=True)])
    masks = PerType(agents=jnp.ones((2, 4), bool), lanes=jnp.ones((2, 3), bool))
    z = PerType(agents=jnp.ones((2, 4, 10)), lanes=jnp.ones((2, 3, 24)))

    @jax.jit
    def evaluate(kinds):
        label = jnp.zeros(2, jnp.int32)
        return network.apply(params, z, jnp.full(2, 50), label, masks, kinds=kinds)

    nothing = PerType(agents=jnp.full((2, 4), NO_KIND), lanes=jnp.full((2, 3), NO_KIND))
    without = evaluate(nothing)
    np.testing.assert_allclose(without.agents, evaluate(None).agents, atol=1e-6)
    for given in (
        nothing.replace(agents=nothing.agents.at[0, 1].set(5)),
        nothing.replace(lanes=nothing.lanes.at[0, 1].set(1)),
    ):
        changed = np.abs(evaluate(given).agents - without.agents).max((1, 2))
        assert changed[0] > 1e-4 and changed[1] == 0


@pytest.mark.parametrize("sizes", [(4, 0), (-3,), (2000,)])
def test_sizes_of_digits_are_whole_numbers(sizes):
    with pytest.raises(ValueError, match="agent_kinds is"):
        DenoiserConfig(agent_kinds=sizes, lane_kinds=(2,))


def test_kinds_of_both_types_belong_together():
    with pytest.raises(ValueError, match="give both or neither"):
        DenoiserConfig(agent_kinds=(2,))
