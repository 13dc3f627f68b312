"""A small town: a map by hand, SUMO's reading of it by hand, and traffic on it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from scjax.data.readers.opendrive.map_lanes import road_map_log
from scjax.data.readers.opendrive.road_map import RoadMap, build_road_map
from scjax.scene import AgentType, Log, LogMetadata, Signal, save_log
from scjax.towns.source import TownRun, Towns
from scjax.towns.town_traffic import TownTraffic, collect_traffic, save_traffic
from scjax.towns.tracks import Track
from tests.factories import opendrive_files as files

NET = """<net>
  <edge id="-1"><lane id="-1_0" index="0" speed="10" length="94" shape="0,0 94,0" disallow="pedestrian">
    <param key="origId" value="1_-1"/></lane></edge>
  <edge id="-2"><lane id="-2_0" index="0" speed="10" length="95" shape="125,0.3 220,0.3" disallow="pedestrian">
    <param key="origId" value="2_-1"/></lane></edge>
  <edge id="-3"><lane id="-3_0" index="0" speed="10" length="96" shape="110,14 110,110">
    <param key="origId" value="3_-1"/></lane></edge>
  <edge id=":9_0" function="internal"><lane id=":9_0_0" index="0" speed="10" length="20" shape="94,0 110,0"/></edge>
  <edge id=":9_2" function="internal"><lane id=":9_2_0" index="0" speed="10" length="11" shape="110,0 125,0"/></edge>
  <edge id=":9_1" function="internal"><lane id=":9_1_0" index="0" speed="10" length="22" shape="94,0 110,14"/></edge>
  <edge id=":9_c0" function="crossing">
    <lane id=":9_c0_0" index="0" allow="pedestrian" length="6" shape="97,-3 97,3"/></edge>
  <tlLogic id="9" type="static" programID="0" offset="5">
    <phase duration="20" state="Gr"/><phase duration="3" state="yr"/><phase duration="17" state="rG"/>
  </tlLogic>
  <connection from="-1" to="-2" fromLane="0" toLane="0" via=":9_0_0" tl="9" linkIndex="0" dir="s" state="o"/>
  <connection from="-1" to="-3" fromLane="0" toLane="0" via=":9_1_0" tl="9" linkIndex="1" dir="l" state="o"/>
  <connection from=":9_0" to="-2" fromLane="0" toLane="0" via=":9_2_0" dir="s" state="M"/>
  <connection from=":9_2" to="-2" fromLane="0" toLane="0" dir="s" state="M"/>
  <connection from=":9_1" to="-3" fromLane="0" toLane="0" dir="l" state="M"/>
</net>
"""
"""The fork of ``opendrive_files`` as netconvert might read it: edges cut off at the junction, a lane 0.3 m aside."""


def fork_map() -> RoadMap:
    """The fork of ``opendrive_files``."""
    return build_road_map(files.root(*files.fork()))


def fork_log() -> Log:
    """The log of ``fork_map``."""
    return road_map_log(fork_map(), LogMetadata(source_file="fork"))


def write_net(folder: Path) -> Path:
    """Writes ``NET``."""
    path = folder / "net.xml"
    path.write_text(NET, encoding="utf-8")
    return path


def straight_track(
    name: str = "a",
    speed: float = 5.0,
    start: int = 0,
    steps: int = 300,
    x: float = 0.0,
    y: float = 0.0,
    agent_type: AgentType = AgentType.VEHICLE,
    size: tuple[float, float, float] = (4.5, 1.8, 1.5),
) -> Track:
    """An object that moves along x."""
    positions = np.zeros((steps, 3))
    positions[:, 0] = x + speed * 0.1 * np.arange(steps)
    positions[:, 1:] = y, size[2] / 2
    return Track(name, agent_type, size, start, positions, np.zeros(steps))


def fork_traffic(*tracks: Track, steps: int = 300) -> TownTraffic:
    """Tracks on the fork, with a signal on its straight way that turns from green to red half way."""
    states = np.where(np.arange(steps) < steps // 2, Signal.GO, Signal.STOP).astype(np.int8)[None]
    return collect_traffic(tracks or (straight_track(),), ["4.0.-1"], states)


def write_fork_town(folder: Path, splits: Mapping[str, str] = MappingProxyType({"A": "train"})) -> Towns:
    """Towns of one map, named with their splits; two logs each. Their files are written to ``folder``."""
    save_log(fork_log(), folder / "map.npz")
    traffic = fork_traffic(straight_track("ego"), straight_track("next", x=12.0))
    save_traffic(dataclasses.replace(traffic, egos=np.array([[20, 0], [120, 0]])), folder / "traffic.npz")
    paths = str(folder / "map.npz"), str(folder / "traffic.npz")
    return Towns(tuple(TownRun(town, 0, *paths, town, 2, split) for town, split in splits.items()))
