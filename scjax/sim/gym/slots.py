"""What single and vector environments share: how episodes are drawn, and what ``info`` says of a step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import UInt8

from scjax.scene import Log
from scjax.scene.arguments import whole_number
from scjax.sim.closed_loop import DrivingTerms

_RADIUS, _SIZE = 40.0, 480  # m from the middle to the edge of a picture, pixels


def chosen_source(rng: np.random.Generator, count: int, choice: Any) -> int:
    """The row of the next source: ``choice``, or drawn.

    Raises:
      ValueError: there is no such source.
    """
    drawn = int(rng.integers(count))  # always, so that a choice changes nothing else
    return drawn if choice is None else whole_number(choice, "source", 0, count - 1)


def episode_seed(rng: np.random.Generator) -> int:
    """Seed of the traffic of the next episode."""
    return int(rng.integers(1 << 32))


def step_infos(terms: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``DrivingTerms`` of a step, in the types that Gymnasium's vector environments use."""
    kinds = {"f": np.float64, "b": np.bool_}
    return {name: terms[name].astype(kinds[terms[name].dtype.kind]) for name in DrivingTerms._fields}


def draw_moment(log: Log) -> UInt8[np.ndarray, "480 480 3"]:
    """40 m around the ego of a log of one step, from above."""
    from scjax.viz.log_frames import LogFrames

    return LogFrames(log, log.ego_index, np.zeros(2), _RADIUS, _SIZE, heading_up=False).draw(0)
