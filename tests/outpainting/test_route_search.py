"""Routes that go back where no road leads on, on maps written by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.data.map_crop import crop_map
from scjax.outpainting.outpaint import outpaint_steps
from scjax.outpainting.route_search import RouteSearch
from scjax.scene import Map, MapTile, TileStatus, join_maps
from tests.factories.maps import map_lane, two_tile_map


def _fork() -> Map:
    """A tile in which a road from the west goes on to the east and to the north."""
    lanes = (
        map_lane("in", (-32, 0), (0, 0), successors=("east", "north")),
        map_lane("east", (0, 0), (32, 0), predecessors=("in",)),
        map_lane("north", (0, 0), (0, 32), predecessors=("in",)),
    )
    return Map(lanes=lanes, tiles=(MapTile(x=0.0, y=0.0, lane_ids=("in", "east", "north")),), has_topology=True)


def _tile(map: Map, x: float, y: float, yaw: float, length: float) -> Map:
    """The map with a tile that has one lane of this length, or with a missing tile."""
    name, way = str(len(map.tiles)), np.array([np.cos(yaw), np.sin(yaw)])
    if not length:
        tile = MapTile(x=x, y=y, yaw=yaw, status=TileStatus.MISSING, attempts=8, fault="nothing")
        return dataclasses.replace(map, tiles=(*map.tiles, tile))
    end = next(lane for lane in map.lanes if np.hypot(*(lane.points[-1, :2] - (x, y))) < 12 and not lane.successors)
    start = end.points[-1, :2]
    lane = map_lane(name, tuple(start), tuple(start + length * way))
    tile = MapTile(x=x, y=y, yaw=yaw, status=TileStatus.COMPLETE, attempts=8, lane_ids=(name,))
    addition = Map(lanes=(lane,), tiles=(tile,), has_topology=True)
    return join_maps(map, addition, [(end.id, name)])


def _search(returns: int = 9) -> RouteSearch:
    return RouteSearch(_fork(), "in", "straight", np.random.default_rng(0), returns=returns)


def _advance(search: RouteSearch, length: float) -> str | None:
    """Adds a tile whose lane has this length; the exit at which it lies."""
    chosen = search.next_exit()
    if chosen is None:
        return None
    routed = search.routed(chosen)
    search.add(_tile(routed, chosen.pose.x, chosen.pose.y, chosen.pose.yaw, length))
    return chosen.lane_ids[-1]


def test_a_route_goes_back_to_another_exit_where_its_tile_leads_nowhere():
    search = _search()
    assert [_advance(search, 12.0), _advance(search, 32.0)] == ["east", "north"]
    assert search.depth == 1 and search.next_exit().lane_ids[-1] == "2"
    assert [tile.status for tile in search.map.tiles] == [TileStatus.KNOWN, TileStatus.MISSING, TileStatus.COMPLETE]
    gone = search.map.tiles[1]
    assert gone.fault.startswith("taken back") and gone.attempts == 8 and gone.lane_ids == ()
    assert [lane.id for lane in search.map.lanes] == ["in", "east", "north", "2"]


def test_a_route_goes_back_where_no_candidate_continues_it():
    search = _search()
    assert [_advance(search, 0.0), _advance(search, 32.0), _advance(search, 32.0)] == ["east", "north", "2"]


def test_every_exit_is_tried_twice_and_the_longest_route_stays():
    search = _search()
    visited = []
    while (name := _advance(search, 32.0 if len(visited) == 0 else 12.0 if len(visited) < 9 else 0.0)) is not None:
        visited.append(name)
    assert visited[:3] == ["east", "1", "1"], "the tile behind the last exit is made once more"
    assert visited.count("east") == visited.count("north") == 2
    assert search.best.routes[0].lane_ids == ("in", "east", "1")


def test_a_route_gives_up_after_so_many_returns():
    search = _search(returns=1)
    assert [_advance(search, 12.0) for _ in range(4)] == ["east", "north", None, None]


@pytest.mark.parametrize(("lengths", "reached"), [((12.0, 32.0, 32.0), 96.0), ((12.0,) * 9, 64.0), ((0.0,) * 9, 64.0)])
def test_maps_go_on_from_an_earlier_exit_or_stay_partial(lengths, reached, monkeypatch):
    left = list(lengths)

    def extend(key, map, condition, *, x, y, yaw, **options):
        return _tile(map, x, y, yaw, left.pop(0) if left else 0.0)

    monkeypatch.setattr("scjax.outpainting.outpaint.extend_map", extend)
    *_, map = outpaint_steps(0, _fork(), length=96.0, at=(-20.0, 0.0, 0.0), retries=0)
    lanes = map.lane_by_id
    assert sum(np.hypot(*(lanes[name].points[-1] - lanes[name].points[0])[:2]) for name in map.routes[0].lane_ids) == (
        reached
    )


@pytest.mark.parametrize(("leads_out", "drawn"), [((False, True), 2), ((True,), 1), ((False,) * 4, 4)])
def test_a_sampled_start_is_one_that_its_ego_can_leave(leads_out, drawn, monkeypatch):
    street = crop_map(two_tile_map(), 0.0, -2.0)
    blind = crop_map(Map(lanes=(map_lane("blind", (-32, 0), (10, 0)),), has_topology=True), 0.0, 0.0)
    count = []

    def sample(*arguments, **options):
        count.append(len(count))
        return [street if leads_out[count[-1]] else blind]

    monkeypatch.setattr("scjax.outpainting.outpaint.sample_scenes", sample)
    start = next(outpaint_steps(0))
    assert len(count) == drawn and start.num_lanes == (street if any(leads_out) else blind).num_lanes
