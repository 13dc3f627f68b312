"""Motions that lead into other bodies."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from scjax.scene.boxes import overlaps
from scjax.sim.agents import Agents
from scjax.sim.contacts import _MARGIN, REPEATS, _poses, _touch, free_checks


def _agents(x, y, heading) -> Agents:
    zeros = jnp.zeros(len(x))
    whole = jnp.zeros(len(x), jnp.int32)
    return Agents(
        x=jnp.asarray(x, jnp.float32),
        y=jnp.asarray(y, jnp.float32),
        z=zeros,
        heading=jnp.asarray(heading, jnp.float32),
        speed=zeros,
        valid=whole == 0,
        length=zeros + 4,
        width=zeros + 2,
        height=zeros + 1.5,
        kind=whole,
        entries=whole,
    )


def test_bodies_touch_as_boxes_overlap():
    rng = np.random.default_rng(0)
    num = 30
    x, y, heading = rng.uniform(-8, 8, num), rng.uniform(-8, 8, num), rng.uniform(-3, 3, num)
    agents = _agents(x, y, heading)
    near = jnp.broadcast_to(jnp.arange(num)[None], (num, num))
    poses = _poses(agents, jnp.zeros((num, 3)), 1)
    touches = np.asarray(_touch(poses, poses, agents, near))
    boxes = np.zeros((num, 9))
    boxes[:, 0], boxes[:, 1], boxes[:, 4], boxes[:, 5] = x, y, np.cos(heading), np.sin(heading)
    boxes[:, 6:8] = [4, 2]
    for row in range(num):
        wide = boxes[row : row + 1].copy()
        wide[:, 6:8] += 2 * _MARGIN
        exact = overlaps(np.concatenate([wide, boxes]))[0, 1:]
        others = np.arange(num) != row
        np.testing.assert_array_equal(touches[row, others], exact[others])


def test_free_choices_pass_all_checks():
    agents = _agents([0.0, 12.0], [0.0, 0.0], [0.0, np.pi])  # head on, 8 m between the bumpers
    choices = jnp.array([[[2.0, 0, 0], [0.5, 0, 0], [2.0, 0, 0.4]]] * 2)
    last = jnp.array([[0.0, 0, 0], [1.0, 0, 0]])
    near, there = jnp.array([[1], [0]]), jnp.ones((2, 1), bool)
    number = np.asarray(free_checks(agents, choices, last, near, there))
    assert number[0].tolist() == [1, 3, 3]  # 3 steps of both are 9 m; a slow motion and one that turns away are free
    alone = np.asarray(free_checks(agents, choices, last, near, ~there))
    assert (alone == len(REPEATS)).all()


def test_bodies_that_touch_before_do_not_count():
    agents = _agents([0.0, 3.0], [0.0, 0.0], [0.0, 0.0])
    choices = jnp.array([[[1.0, 0, 0]]] * 2)
    number = free_checks(agents, choices, jnp.zeros((2, 3)), jnp.array([[1], [0]]), jnp.ones((2, 1), bool))
    assert (np.asarray(number) == len(REPEATS)).all()
