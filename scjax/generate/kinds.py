"""The kind of every agent of a scene to sample, for networks that read kinds."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.language.attributes.contradictions import least_numbers
from scjax.models.codec import SceneCodec
from scjax.models.counts.kinds import KINDS, KindCounts, draw_kind_counts
from scjax.models.counts.prior import Table
from scjax.models.denoiser.agent_kinds import NO_KIND, agent_kinds
from scjax.scene import AgentType, Crop, Scene

_CLASSES = (AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.CYCLIST, AgentType.STATIC)  # of the first columns


def draw_kinds(
    rng: np.random.Generator, condition: Condition, known: Scene | None, model: Model, table: Table | None
) -> Int[np.ndarray, " tokens"] | None:
    """Kinds of the ego, of the known agents and of the others, whose order is random.

    Args:
      known: known elements in token order, unpadded; None: none.
      table: probabilities of the numbers of lanes and agents.

    Returns:
      None where the network decides: it reads no kinds, the window is not centered on the ego, or no scene of the
      training with ``condition.num_agents`` agents fulfills the request.
    """
    config = model.denoiser.config
    if model.kind_counts is None or not config.agent_kinds or condition.crop != Crop.CENTERED or table is None:
        return None
    first = _kinds_of_known(known, model.codec)
    known_counts, requested = _counts_of(first[1:], model.codec), least_numbers(condition.attributes)
    counts = draw_kind_counts(
        rng,
        model.kind_counts,
        _totals(table, condition),
        condition.attributes,
        least=np.maximum(known_counts, [int(requested.get(name, 0)) for name in KINDS]),
        most=config.max_agents,
        total=condition.num_agents,
    )
    if counts is None:
        return None
    cars, *others = counts - known_counts
    more = np.repeat(_kind_of_columns(model.codec), [cars - others[-1], *others])
    return np.concatenate([first, rng.permutation(more)]).astype(np.int32)


def _kinds_of_known(known: Scene | None, codec: SceneCodec) -> np.ndarray:
    """Kinds of the known agents, the ego first; of the ego alone where nothing is known."""
    if known is None or not len(known.agent_mask):
        return _kind_of_columns(codec)[:1]
    return np.asarray(agent_kinds(known, codec))


def _counts_of(kinds: np.ndarray, codec: SceneCodec) -> KindCounts:
    counts = (kinds[:, None] == _kind_of_columns(codec)).sum(0)
    counts[0] += counts[-1]  # large vehicles are vehicles
    return counts.astype(np.int32)


def _kind_of_columns(codec: SceneCodec) -> np.ndarray:
    """The network's kind for each of ``KINDS``; vehicles that are not large for the first."""
    types = list(codec.agent_types)
    kinds = [types.index(one) if one in types else NO_KIND for one in _CLASSES]
    assert len(kinds) + 1 == len(KINDS)
    return np.array([*kinds, len(types)])


def _totals(table: Table, condition: Condition) -> Float[np.ndarray, " totals"]:
    """Probabilities of the number of agents, for this crop and number of lanes where the table knows them."""
    own = table[:, condition.crop].sum(0, dtype=np.float64)
    lanes = condition.num_lanes
    if lanes is not None and lanes < len(own) and own[lanes].any():
        return own[lanes]
    return own.sum(0) if own.any() else table.sum((0, 1, 2), dtype=np.float64)
