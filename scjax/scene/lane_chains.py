"""Merging the degree-2 chains of a lane graph: lanes that only follow each other become one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int


def merge_degree2_chains(
    count: int, joins: set[tuple[int, int]], breaks: frozenset[tuple[int, int]] = frozenset()
) -> tuple[list[list[int]], Int[np.ndarray, "edges 2"]]:
    """Chains of lanes that only follow each other, and the edges between the chains.

    Lane j is merged into i if j is the only successor of i and i the only predecessor of j. Chains are ordered by their
    first lane; closed rings come last and start at their smallest lane.

    Args:
      count: number of lanes.
      joins: pairs (i, j), lane j follows lane i.
      breaks: pairs of ``joins`` that are not merged.

    Returns:
      chains: lanes of each chain, in driving direction.
      edges: (a, b), chain b follows chain a.
    """
    successors: list[list[int]] = [[] for _ in range(count)]
    predecessors: list[list[int]] = [[] for _ in range(count)]
    for i, j in sorted(joins):
        successors[i].append(j)
        predecessors[j].append(i)
    follower = {i: s[0] for i, s in enumerate(successors) if len(s) == 1 and predecessors[s[0]] == [i] and s[0] != i}
    follower = {i: j for i, j in follower.items() if (i, j) not in breaks}
    merged = set(follower.values())
    chains, used = [], set()
    # After the starts of open chains, the lanes left over belong to closed rings.
    for start in [i for i in range(count) if i not in merged] + sorted(merged):
        if start in used:
            continue
        chain = [start]
        while (following := follower.get(chain[-1])) is not None and following != start:
            chain.append(following)
        used.update(chain)
        chains.append(chain)
    chain_of = {lane: row for row, chain in enumerate(chains) for lane in chain}
    edges = [(row, chain_of[j]) for row, chain in enumerate(chains) for j in successors[chain[-1]]]
    return chains, np.array(edges, np.int64).reshape(-1, 2)
