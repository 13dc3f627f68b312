"""Pedestrians beside bodies that stand."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from scjax.scene import AgentType
from scjax.sim.agents import Agents
from scjax.sim.walking import walk


def _agents(rows) -> Agents:
    """x, y, heading [rad], length and width of bodies; the first one walks."""
    x, y, heading, length, width = (jnp.asarray(column, jnp.float32) for column in np.array(rows).T)
    zeros = jnp.zeros_like(x)
    kind = jnp.array([AgentType.PEDESTRIAN, *[AgentType.STATIC] * (len(rows) - 1)], jnp.int32)
    return Agents(
        x=x, y=y, z=zeros, heading=heading, speed=zeros, valid=jnp.ones(len(rows), bool), length=length, width=width,
        height=zeros + 1.0, kind=kind, entries=jnp.zeros(len(rows), jnp.int32),
    )  # fmt: skip


@pytest.fixture
def before_a_wall() -> Agents:
    return _agents([(0.0, 0.0, 0.0, 0.6, 0.6), (1.2, 0.0, 0.0, 1.0, 20.0)])


def test_who_cannot_pass_turns_back_for_good(before_a_wall):
    agents, pace = before_a_wall, jnp.array([1.3, 0.0])
    for _ in range(20):
        agents = walk(agents, pace, 0.1)
    assert float(agents.x[0]) == pytest.approx(-2.6, abs=0.1)
    assert abs(float(agents.heading[0])) == pytest.approx(np.pi, abs=1e-3)


def test_a_free_way_is_walked_straight_on():
    agents = walk(_agents([(0.0, 0.0, 0.0, 0.6, 0.6)]), jnp.array([1.3]), 0.1)
    assert float(agents.x[0]) == pytest.approx(0.13) and float(agents.heading[0]) == 0.0
