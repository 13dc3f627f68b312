"""Maps written by hand: two tiles with a seam, and a large grid of streets."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import AgentType, Map, MapLane, MapRoute, MapSeam, MapTile, Signal, TileStatus

TILE_SPACING = 64.0  # m


def map_lane(name: str, *points: tuple[float, ...], **fields) -> MapLane:
    """A lane through points (x, y) or (x, y, z)."""
    rows = [(*point, 0.0)[:3] for point in points]
    return MapLane(id=name, lane_type="surface_street", points=np.array(rows, np.float64), **fields)


def two_tile_map(**changes) -> Map:
    """A street of two lanes through two tiles: ``ahead-0`` and ``ahead-1`` go east, ``back-1`` and ``back-0`` west."""
    lanes = (
        map_lane("ahead-0", (-32, -2), (32, -2), successors=("ahead-1",)),
        map_lane("back-0", (32, 2), (-32, 2), predecessors=("back-1",)),
        map_lane("ahead-1", (32, -2), (96, -2), predecessors=("ahead-0",)),
        map_lane("back-1", (96, 2), (32, 2), successors=("back-0",)),
    )
    tiles = (
        MapTile(x=0.0, y=0.0, lane_ids=("ahead-0", "back-0"), agent_ids=("car",)),
        MapTile(
            x=TILE_SPACING,
            y=0.0,
            status=TileStatus.INCOMPLETE,
            attempts=3,
            prompt="a street",
            fault="no vehicle",
            lane_ids=("ahead-1", "back-1"),
        ),
    )
    seam = MapSeam(
        tiles=(0, 1), start=(32.0, -32.0), end=(32.0, 32.0), connections=(("ahead-0", "ahead-1"), ("back-1", "back-0"))
    )
    map = Map(
        lanes=lanes,
        signal_lane_ids=("ahead-1",),
        signal_states=np.array([Signal.STOP], np.int32),
        signal_positions=np.array([[32.0, -2.0, np.nan]]),
        agent_ids=("car",),
        agent_types=np.array([AgentType.VEHICLE], np.int32),
        agents=np.array([[0.0, -2.0, np.nan, 8.0, 1.0, 0.0, 4.5, 2.0, np.nan]]),
        tiles=tiles,
        seams=(seam,),
        routes=(MapRoute(lane_ids=("ahead-0", "ahead-1"), start=10.0, end=50.0, name="east"),),
    )
    return dataclasses.replace(map, **changes)


def street_grid(edge: float, spacing: float = 100.0) -> Map:
    """Streets of two lanes along x and y over a square of this edge [m], cut at every crossing, without turns."""
    lanes = []
    places = np.arange(0.0, edge + 1e-6, spacing)
    for across, place in enumerate(places):
        for step in range(len(places) - 1):
            along = np.linspace(places[step], places[step + 1], 11)
            for axis in (0, 1):
                for side, order in ((-2.0, 1), (2.0, -1)):
                    points = np.zeros((len(along), 3))
                    points[:, axis] = along[::order]
                    points[:, 1 - axis] = place + (side if axis == 0 else -side)
                    after, before = (f"{axis}.{across}.{step + shift}.{order}" for shift in (order, -order))
                    name = f"{axis}.{across}.{step}.{order}"
                    lanes.append(MapLane(name, "surface_street", points, (before,), (after,)))
    return Map(lanes=tuple(lanes))
