"""A growing map: tiles that lead nowhere, and tiles that are taken back."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from scjax.outpainting.exits import RoadExit
from scjax.outpainting.window import WindowPose
from scjax.scene import MapTile, TileStatus
from scjax.scene.map import Map
from scjax.sim.map_growth import MapGrowth
from tests.factories.maps import map_lane

HERE = np.array([20.0, 0.0])


def _first() -> Map:
    """A road of 64 m along x in one tile."""
    lane = map_lane("road", (0.0, 0.0, 0.0), (64.0, 0.0, 0.0))
    return Map(lanes=(lane,), tiles=(MapTile(x=32.0, y=0.0, lane_ids=("road",)),))


@pytest.fixture
def growth(monkeypatch):
    """A map whose tiles are as long as ``lengths`` says, one number a tile [m], and the numbers of the keys."""
    lengths: list[float] = []
    keys: list[int] = []

    def extend(key, map, condition, *, x, y, yaw, **options):
        keys.append(int(jax.random.key_data(key)[-1]))
        length, name = lengths.pop(0), f"tile-{len(keys)}"
        tile = MapTile(x=x, y=y, yaw=yaw, status=TileStatus.COMPLETE, lane_ids=(name,))
        last = next(lane for lane in map.lanes if not lane.successors)
        end = last.points[-1]
        new = map_lane(name, tuple(end), (float(end[0]) + length, 0.0, 0.0), predecessors=(last.id,))
        lanes = tuple(dataclasses.replace(lane, successors=(name,)) if lane is last else lane for lane in map.lanes)
        return dataclasses.replace(map, lanes=(*lanes, new), tiles=(*map.tiles, tile))

    monkeypatch.setattr("scjax.sim.map_growth.extend_map", extend)
    run = MapGrowth(jax.random.key(0), _first(), None, way="straight", yaw=0.0, rng=np.random.default_rng(0))
    return run, lengths, keys


def test_a_tile_beyond_which_no_road_goes_on_is_drawn_again(growth):
    run, lengths, keys = growth
    lengths += [10.0, 31.5]  # the first ends inside of its tile
    assert run.extend("road", HERE) and run.path == ("road",)
    assert [lane.id for lane in run.map.lanes] == ["road", "tile-2"]
    assert [tile.status for tile in run.map.tiles[1:]] == [TileStatus.MISSING, TileStatus.COMPLETE]
    assert len(set(keys)) == 2


def test_tiles_out_of_sight_are_taken_back(growth):
    run, lengths, _ = growth
    lengths += [31.5, 31.5, 10.0, 10.0, 31.5]
    assert run.extend("road", HERE) and run.extend("tile-1", HERE)
    assert run.extend("tile-1", HERE)  # two tiles beyond the second one fail: that one is drawn again
    assert [lane.id for lane in run.map.lanes] == ["road", "tile-1", "tile-5"]
    assert [tile.lane_ids for tile in run.gone] == [("tile-2",)]


def test_tiles_in_sight_stay(growth):
    run, lengths, _ = growth
    lengths += [31.5, 31.5, 10.0, 10.0]
    assert run.extend("road", HERE) and run.extend("tile-1", HERE)
    before = run.map
    assert not run.extend("tile-1", np.array([60.0, 0.0]))
    assert run.map is before and not run.gone


def test_the_way_goes_on_where_the_last_tile_is(growth, monkeypatch):
    run, lengths, _ = growth
    lengths += [31.5, 31.5]
    assert run.extend("road", HERE) and run.extend("road", HERE)
    pose = WindowPose(95.0, 0.0, 0.0, 0.0)
    onward = RoadExit(("road", "tile-1", "tile-2"), pose._replace(yaw=1.0), 0.0)
    straight = RoadExit(("road", "other"), pose, 0.0)
    monkeypatch.setattr("scjax.sim.map_growth.find_exits", lambda map, first: [straight, onward])
    assert run.path[-1] == "tile-1"
    assert run._next_exit(run.map, "road", 0.0, run.path) is onward
    assert run._next_exit(run.map, "road", 0.0) is straight
    monkeypatch.setattr("scjax.sim.map_growth.find_exits", lambda map, first: [straight])
    assert run._next_exit(run.map, "road", 0.0, run.path) is straight


@pytest.mark.parametrize(("turned", "onward"), [(0.4, 0.4), (2.5, np.pi / 2), (-2.5, -np.pi / 2)])
def test_the_way_does_not_lead_back(turned, onward, growth, monkeypatch):
    """Of the next exits the one in the direction of the last tile is taken, up to a quarter turn from the first one."""
    run, lengths, _ = growth
    lengths += [31.5]
    pose = WindowPose(31.5, 0.0, 0.0, turned)
    monkeypatch.setattr("scjax.sim.map_growth.find_exits", lambda map, first: [RoadExit((first,), pose, 0.0)])
    monkeypatch.setattr("scjax.sim.map_growth.choose_exit", lambda exits, rng, *, yaw, way: exits[0] if exits else None)
    assert run.extend("road", HERE)
    directions = []
    monkeypatch.setattr("scjax.sim.map_growth.choose_exit", lambda exits, rng, *, yaw, way: directions.append(yaw))
    assert not run.extend("tile-1", np.array([60.0, 0.0]))
    assert directions[0] == pytest.approx(onward)
