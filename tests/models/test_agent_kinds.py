"""Kinds of agents: one for each class, and large vehicles apart; what the denoiser does with them."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from scjax.models import codec
from scjax.models.denoiser.agent_kinds import NO_KIND, agent_kinds, num_kinds
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.scene import AgentType, empty, pad
from scjax.scene.per_type import PerType


def _scene():
    scene = empty(5, 1)
    scene.agents[:, 6] = (4.5, 12.0, 0.5, 9.0, 1.8)
    scene.agent_types[:] = [
        AgentType.VEHICLE,
        AgentType.VEHICLE,
        AgentType.PEDESTRIAN,
        AgentType.STATIC,
        AgentType.CYCLIST,
    ]
    scene.agent_mask[:] = True
    return scene


def test_kinds_are_classes_and_large_vehicles():
    own = codec.scjax()
    kinds = [own.agent_types.index(one) for one in _scene().agent_types]
    kinds[1] = num_kinds(own) - 1
    assert agent_kinds(_scene(), own).tolist() == kinds
    assert agent_kinds(pad(_scene(), 7, 1), own).tolist() == [*kinds, NO_KIND, NO_KIND]


def test_classes_that_a_codec_lacks_have_no_kind():
    own = dataclasses.replace(codec.scjax(), agent_types=(AgentType.VEHICLE,), sizes=codec.scjax().sizes[:1])
    assert agent_kinds(_scene(), own).tolist() == [0, 1, NO_KIND, NO_KIND, NO_KIND]


def test_a_kind_changes_its_scene_alone_and_none_changes_nothing():
    sizes = {"lane_width": 16, "lane_heads": 2, "agent_width": 8, "agent_heads": 2, "blocks": 1, "mlp_ratio": 2}
    network = denoiser(DenoiserConfig(agent_kinds=3, **sizes))
    leaves, tree = jax.tree.flatten(network.init(jax.random.key(0)))
    noise = [0.2 * np.random.default_rng(i).normal(size=leaf.shape) for i, leaf in enumerate(leaves)]
    params = jax.tree.unflatten(tree, [jnp.asarray(x + y, jnp.float32) for x, y in zip(leaves, noise, strict=True)])
    masks = PerType(agents=jnp.ones((2, 4), bool), lanes=jnp.ones((2, 3), bool))
    z = PerType(agents=jnp.ones((2, 4, 10)), lanes=jnp.ones((2, 3, 24)))

    @jax.jit
    def evaluate(kinds):
        label = jnp.zeros(2, jnp.int32)
        return network.apply(params, z, jnp.full(2, 50), label, masks, agent_kinds=kinds).agents

    nothing = jnp.full((2, 4), NO_KIND)
    given = evaluate(nothing.at[0, 1].set(2))
    np.testing.assert_array_equal(evaluate(nothing), evaluate(None))
    changed = np.abs(given - evaluate(nothing)).max((1, 2))
    assert changed[0] > 1e-3 and changed[1] == 0
