"""Prior of the numbers of lanes and agents: a smoothed joint table per domain and crop, and samples from it.

The paper's learned regressor (f_count) conditions on tokens; this prior is used for conditions without counts.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from scjax.scene import MAX_AGENTS, MAX_LANES, Crop

Table = Float[np.ndarray, "domains crops lanes agents"]


def count_table(
    counts: Iterable[tuple[int, int, int, int]],
    domains: int,
    *,
    max_lanes: int = MAX_LANES,
    max_agents: int = MAX_AGENTS,
    bandwidth: float = 0.1,
) -> Table:
    """Kernel-smoothed joint probabilities of (N_l, N_o) from (domain, crop, lanes, agents) of real scenes.

    The kernel is Gaussian in log counts (``bandwidth``), since thousands of scenes fill only a part of the cells.
    Cells of zero lanes or agents stay empty. The whole table sums to 1; its marginal over domains and crops is that
    of the data.
    """
    raw = np.zeros((domains, len(Crop), max_lanes + 1, max_agents + 1))
    for domain, crop, lanes, agents in counts:
        raw[domain, crop, min(lanes, max_lanes), min(agents, max_agents)] += 1
    raw[:, :, 0, :], raw[:, :, :, 0] = 0, 0

    def kernel(size: int) -> np.ndarray:
        log = np.log(np.arange(1, size + 1))
        weights = np.exp(-0.5 * ((log[:, None] - log[None, :]) / bandwidth) ** 2)
        return weights / weights.sum(1, keepdims=True)

    raw[:, :, 1:, 1:] = kernel(max_lanes).T @ raw[:, :, 1:, 1:] @ kernel(max_agents)
    return (raw / max(raw.sum(), 1e-12)).astype(np.float32)


def draw_counts(
    rng: np.random.Generator,
    table: Table | None,
    crop: Crop,
    *,
    domain: int | None = None,
    num_lanes: int | None = None,
    num_agents: int | None = None,
    least_lanes: int = 0,
    least_agents: int = 0,
) -> tuple[int, int, int]:
    """A sample of (domain, N_l, N_o), conditional on the arguments that are not None and on the lower bounds.

    If no cell of this crop and domain is allowed, all crops of the domain are used, then all domains. If still no
    cell is allowed, the bounds themselves are returned.

    Raises:
      ValueError: there is no table, and a count is None.
    """
    if table is None:
        if num_lanes is None or num_agents is None:
            raise ValueError("this model has no table of counts: give Condition.num_lanes and Condition.num_agents")
        return domain or 0, num_lanes, num_agents
    rows = slice(max(least_lanes, 1), None) if num_lanes is None else num_lanes
    columns = slice(max(least_agents, 1), None) if num_agents is None else num_agents
    allowed = np.zeros(table.shape[2:], bool)
    allowed[rows, columns] = True
    # This crop and domain first; without data for them, all crops of the domain, then all domains.
    own_crop = table[:, crop].astype(np.float64)
    any_crop = table.sum(1, dtype=np.float64)
    own = slice(None) if domain is None else slice(domain, domain + 1)
    for cells in (own_crop[own], any_crop[own], any_crop):
        cells = np.where(allowed[None], cells, 0)
        if cells.any():
            index = rng.choice(cells.size, p=(cells / cells.sum()).ravel())
            drawn_domain, lanes, agents = np.unravel_index(index, cells.shape)
            return int(drawn_domain) if domain is None else domain, int(lanes), int(agents)
    return domain or 0, num_lanes or max(least_lanes, 1), num_agents or max(least_agents, 1)
