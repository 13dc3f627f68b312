"""Roads that follow each other one by one, as one road."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence

from scjax.export.roads.lane_curves import join_curves
from scjax.export.roads.planned_road import PlannedRoad


def join_chains(
    roads: Sequence[PlannedRoad], kinds: Sequence[Hashable], lit: Collection[int] = ()
) -> list[PlannedRoad]:
    """The roads with those outside of junctions joined to the road before, if it is the only one and of the same kind.

    Args:
      kinds: of all lanes; lanes of two kinds share no road.
      lit: lanes that keep the road on which they begin, since a traffic light stands there.

    Returns:
      The roads, with new ids from 1.
    """
    by_id = {road.id: road for road in roads}
    follows = {road.id for road in roads if _follows(road, by_id, kinds, lit)}
    joined: dict[int, list[PlannedRoad]] = {}
    for road in roads:
        if road.id not in follows:
            chain = joined[road.id] = [road]
            while chain[-1].after in follows:
                chain.append(by_id[chain[-1].after])
    in_chains = {road.id for chain in joined.values() for road in chain}
    joined |= {road.id: [road] for road in roads if road.id not in in_chains}  # of rings, which have no first road
    numbers = {0: 0} | {road.id: row + 1 for row, chain in enumerate(joined.values()) for road in chain}
    return [_chain_road(chain, numbers) for chain in joined.values()]


def _follows(road: PlannedRoad, by_id: dict[int, PlannedRoad], kinds: Sequence[Hashable], lit: Collection[int]) -> bool:
    """Whether a road can be joined to the one before."""
    before = by_id.get(road.before)
    if road.junction or before is None or before.junction or (road.lane in lit and road.start == 0):
        return False
    return kinds[before.lane] == kinds[road.lane]


def _chain_road(chain: list[PlannedRoad], numbers: dict[int, int]) -> PlannedRoad:
    first, last = chain[0], chain[-1]
    return PlannedRoad(
        numbers[first.id],
        first.curve if len(chain) == 1 else join_curves([road.curve for road in chain]),
        first.lane,
        first.start,
        tuple(lane for road in chain for lane in road.lanes),
        first.junction,
        numbers[first.before],
        numbers[last.after],
        first.junction_before,
        last.junction_after,
    )
