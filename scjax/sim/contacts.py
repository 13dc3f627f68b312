"""Which motions lead into other bodies within a second; jitted, one scene."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.directions import directions

REPEATS = (1, 3, 5)
"""How often motions are repeated before the bodies are compared."""
_MARGIN = 0.1  # m around the body


def free_checks(
    agents: Agents,
    choices: Float[Array, "N C 3"],
    last: Float[Array, "N 3"],
    near: Int[Array, "N K"],
    there: Bool[Array, "N K"],
) -> Int[Array, "N C"]:
    """In how many of the ``REPEATS`` in turn each choice touches none of the neighbors; all of them for a free choice.

    Bodies that touch before do not count.

    Args:
      choices: motions that the agents may do and repeat.
      last: motions that the neighbors repeat.
      near, there: rows of the neighbors, and which of them count.
    """
    still = jnp.zeros_like(last)
    counts = there & ~_touch(_poses(agents, still, 1), _poses(agents, still, 1), agents, near)
    free = jnp.ones(choices.shape[:2], bool)
    number = jnp.zeros(choices.shape[:2], jnp.int32)
    for repeats in REPEATS:
        others = _poses(agents, last, repeats)
        for choice in range(choices.shape[1]):
            touches = (_touch(_poses(agents, choices[:, choice], repeats), others, agents, near) & counts).any(1)
            free = free.at[:, choice].set(free[:, choice] & ~touches)
        number = number + free
    return number


def _poses(agents: Agents, motion: Float[AnyArray, "N 3"], repeats: int) -> tuple[Array, Array, Array]:
    """x, y, heading after some equal motions, on the chord of their arc."""
    turn = 0.5 * (repeats - 1) * motion[:, 2]
    cos, sin = jnp.cos(agents.heading + turn), jnp.sin(agents.heading + turn)
    ahead, left = repeats * motion[:, 0], repeats * motion[:, 1]
    x, y = agents.x + ahead * cos - left * sin, agents.y + ahead * sin + left * cos
    return jnp.asarray(x), jnp.asarray(y), jnp.asarray(agents.heading + repeats * motion[:, 2])


def _touch(
    own: tuple[Array, Array, Array], others: tuple[Array, Array, Array], agents: Agents, near: Int[Array, "N K"]
) -> Bool[AnyArray, "N K"]:
    """Whether bodies at poses overlap those of their neighbors: no edge of one of them lies between the two."""
    x, y, heading = own
    d_x, d_y = others[0][near] - x[:, None], others[1][near] - y[:, None]
    cos, sin = (part[:, None] for part in directions(heading))
    o_cos, o_sin = (part[near] for part in directions(others[2]))
    c, s = jnp.abs(o_cos * cos + o_sin * sin), jnp.abs(o_sin * cos - o_cos * sin)  # of the angle between both
    a, b = (0.5 * agents.length + _MARGIN)[:, None], (0.5 * agents.width + _MARGIN)[:, None]
    e, f = 0.5 * agents.length[near], 0.5 * agents.width[near]
    along = jnp.abs(d_x * cos + d_y * sin) < a + e * c + f * s
    across = jnp.abs(d_y * cos - d_x * sin) < b + e * s + f * c
    its_along = jnp.abs(d_x * o_cos + d_y * o_sin) < e + a * c + b * s
    its_across = jnp.abs(d_y * o_cos - d_x * o_sin) < f + a * s + b * c
    return along & across & its_along & its_across
