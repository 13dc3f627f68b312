"""Agent values as recorded -> values a network can use: unknown or impossible ones are filled and counted."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import AgentType
from scjax.scene.agent_sizes import CLASS_SIZES
from scjax.scene.limits import MAX_SIZE

MAX_SPEED = 35.0  # m/s; faster ones are tracking errors
_SIZES = np.array([CLASS_SIZES[agent_type] for agent_type in AgentType])


def clean_agents(
    states: Float64[np.ndarray, "agents 9"], types: Int[np.ndarray, " agents"]
) -> tuple[Float64[np.ndarray, "agents 9"], Bool[np.ndarray, "agents 9"], dict[str, int]]:
    """States without NaN, impossible sizes and speeds above 35 m/s; which values are known; how many were changed.

    A value that was not recorded is filled (z: 0, sizes: the mean of the class) and flagged unknown. A recorded size of
    0 m or less (or above 100 m) is treated the same and counts under ``size``; a speed above the limit is clipped,
    stays known and counts under ``speed``.
    """
    known = np.isfinite(states)
    sizes = states[:, 6:9]
    finite = np.nan_to_num(sizes)
    wrong = known[:, 6:9] & ~((finite > 0) & (finite <= MAX_SIZE))
    known[:, 6:9] &= ~wrong
    out = np.where(known, states, 0.0)
    out[:, 6:9] = np.where(known[:, 6:9], sizes, _SIZES[types])
    fast = out[:, 3] > MAX_SPEED
    out[:, 3] = np.minimum(out[:, 3], MAX_SPEED)
    return out, known, {"size": int(wrong.any(-1).sum()), "speed": int(fast.sum())}
