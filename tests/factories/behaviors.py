"""Small behaviors with random weights, and random traffic for them."""

from __future__ import annotations

import jax
import numpy as np

from scjax.models.behavior.config import CLASSES, BehaviorConfig
from scjax.models.behavior.network import behavior_network
from scjax.models.behavior.traffic import FAR, WAY, Traffic
from scjax.models.behavior.vocabulary import build_vocabulary
from scjax.sim.behavior_weights import BehaviorWeights

SIZES = BehaviorConfig(width=8, layers=1, heads=2, neighbors=3, history=2, motions=16, returns=4)


def small_vocabulary(seed: int = 0) -> np.ndarray:
    """[C, 16, 3]; changes of motion are random."""
    rng = np.random.default_rng(seed)
    return np.stack([build_vocabulary(np.zeros((0, 3)), kind, SIZES.motions, rng) for kind in range(CLASSES)])


def small_weights(seed: int = 0) -> BehaviorWeights:
    """A network that was never trained, with larger weights than at the start of a training."""
    params = behavior_network(SIZES).init(jax.random.key(seed))
    params = jax.tree.map(lambda leaf: np.asarray(leaf) * 3, params)
    return BehaviorWeights(SIZES, params, small_vocabulary(seed))


def random_traffic(seed: int = 0, agents: int = 8) -> Traffic:
    """Vehicles, pedestrians and cyclists within 60 m on curved ways; the last one is gone."""
    rng = np.random.default_rng(seed)

    def single(values: np.ndarray) -> np.ndarray:
        return values.astype(np.float32)

    x, y, heading = (single(rng.uniform(-r, r, agents)) for r in (30, 30, 3))
    bend = rng.normal(size=(agents, 1)) * 0.01
    angle = heading[:, None] + bend * WAY
    offset = rng.normal(size=(2, agents, 1)) * 0.3
    motions = rng.uniform(0, 1, (agents, SIZES.history, 3)) * [2.0, 0.05, 0.05]
    return Traffic(
        x=x,
        y=y,
        heading=heading,
        length=single(rng.uniform(1, 5, agents)),
        width=single(rng.uniform(0.5, 2, agents)),
        kind=rng.integers(0, 4, agents).astype(np.int32),
        valid=np.arange(agents) < agents - 1,
        motions=single(motions),
        known=rng.random((agents, SIZES.history)) < 0.7,
        way_x=single(x[:, None] + offset[0] + WAY * np.cos(angle)),
        way_y=single(y[:, None] + offset[1] + WAY * np.sin(angle)),
        limit=single(rng.uniform(5, 20, (agents, len(WAY)))),
        inside=WAY[None] < rng.uniform(20, 100, (agents, 1)),
        has_way=rng.random(agents) < 0.8,
        signal=rng.integers(0, 4, agents).astype(np.int32),
        signal_gap=single(rng.uniform(5, 50, agents)),
        end_gap=np.full(agents, FAR, np.float32),
    )
