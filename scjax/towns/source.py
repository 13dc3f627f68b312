"""The towns as a source of records: logs cut from simulations that are made once and kept in the cache."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from scjax.data.build_options import BuildOptions
from scjax.data.lane_bends import split_bends
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.ranges import MAX_COUNT, check_number, check_seed
from scjax.data.readers.base import LogInfo
from scjax.data.readers.opendrive import read_road_map
from scjax.data.readers.opendrive.map_lanes import road_map_log
from scjax.data.record_source import PosedLog
from scjax.data.tiles import Pose, find_poses
from scjax.data.workers import WorkerPool
from scjax.nn.startup import cache_folder
from scjax.scene import Log, LogMetadata, load_log, save_log
from scjax.scene.lane_overlaps import overlap_places
from scjax.towns.simulate_town import TrafficOptions, simulate_town
from scjax.towns.sumo import SUMO_VERSION, find_sumo
from scjax.towns.town_log import DOMAIN, TownMap, cut_log
from scjax.towns.town_table import TOWNS
from scjax.towns.town_traffic import TRAFFIC_VERSION, load_traffic, save_traffic

DENSITIES = ((7.0, 6.0), (14.0, 10.0), (3.0, 2.0), (22.0, 4.0), (0.8, 0.5))
"""Vehicles for each kilometer of lanes, people for each of sidewalks: of the first run of a town, the second, ..."""

_SIGHT = 75.0  # m from a pose to the far corners of its windows


@dataclasses.dataclass(frozen=True)
class TownRun:
    """One simulation of a town.

    Attributes:
      town: name of the map, which is the location of its scenes.
      number: of the simulation, from 0.
      map_file, traffic_file: the log of the map and its traffic, in the cache.
      sha256: of what both were made from.
      count: number of logs.
      split: "train" or "val"; empty if the name of the town decides.
    """

    town: str
    number: int
    map_file: str
    traffic_file: str
    sha256: str
    count: int
    split: str


@dataclasses.dataclass(frozen=True)
class Towns:
    """Logs of 10 s around the egos of simulations. ``make_towns`` makes one."""

    runs: tuple[TownRun, ...]

    def __str__(self) -> str:
        return "towns"

    def names(self) -> list[str]:
        """``town/run/log`` of every log."""
        return [f"{run.town}/{run.number}/{k:04d}" for run in self.runs for k in range(run.count)]

    def scan(self, name: str) -> LogInfo:
        """Hash and location of a log; does not read the simulation."""
        run, _ = self._find(name)
        digest = hashlib.sha256(f"{run.sha256} {name}".encode()).hexdigest()
        return LogInfo(name, digest, DOMAIN, run.town, split=run.split)

    def load(self, item: LogInfo, options: BuildOptions, dense: bool) -> PosedLog:
        """Cuts a log and finds its poses.

        Raises:
          ValueError: its simulation is damaged; names the file.
        """
        log = self.log(item)
        graph = split_bends(build_graph(log, split_at_signals=True, signals_alone=True, bends_alone=True))
        index = index_segments(graph)
        unsound = overlap_places(np.split(graph.points, graph.offsets[1:-1]))
        standard = _sound_poses(find_poses(log, index, **dataclasses.asdict(options.poses)), unsound)
        poses = standard
        if dense:
            poses = find_poses(log, index, **dataclasses.asdict(options.train_poses), first=standard)
            poses = _sound_poses(poses, unsound)
        return PosedLog(log, graph, index, poses, len(standard), warnings=graph.warnings, notes=graph.notes)

    def log(self, item: LogInfo) -> Log:
        """Cuts a log: 2 s before and 8 s after its moment at 10 Hz.

        Raises:
          ValueError: its simulation is damaged; names the file.
        """
        run, number = self._find(item.file)
        metadata = LogMetadata(
            domain=DOMAIN,
            scene_id=item.file,
            location_cluster=run.town,
            variant="sumo",
            source_file=f"{run.town}, simulation {run.number}",
            source_sha256=item.sha256,
        )
        return cut_log(_load_map(run.map_file), _load_traffic(run.traffic_file), number, metadata)

    def _find(self, name: str) -> tuple[TownRun, int]:
        town, run, number = name.rsplit("/", 2)
        return next(item for item in self.runs if (item.town, item.number) == (town, int(run))), int(number)


def _sound_poses(poses: list[Pose], unsound: np.ndarray) -> list[Pose]:
    """Those whose windows show none of the places [n, 2] where lanes lie on each other."""
    return [pose for pose in poses if not len(unsound) or np.hypot(*(unsound - (pose.x, pose.y)).T).min() > _SIGHT]


@functools.lru_cache(maxsize=2)
def _load_map(path: str) -> TownMap:
    return TownMap(load_log(path))


_load_traffic = functools.lru_cache(maxsize=2)(lambda path: load_traffic(Path(path)))


def make_towns(
    folder: str | Path,
    names: Sequence[str] = (),
    *,
    runs: int = 2,
    seconds: float = 120.0,
    seed: int = 0,
    workers: int = 0,
) -> Towns:
    """Simulates traffic on every OpenDRIVE file of a folder, and keeps it in the cache.

    Args:
      folder: of the files.
      names: of the maps, by default all of the folder.
      runs: simulations of each map, with different densities of traffic (``DENSITIES``).
      seconds: length of each [s].
      seed: of all that is drawn.
      workers: processes; 0 works in this one.

    Raises:
      ValueError: an argument is out of its range, a map is not there or cannot be used, or SUMO is not here or fails.
    """
    check_number("runs", runs, 1, 1000, "make at least one simulation of each town")
    check_number("seconds", seconds, 20, 3600, "give at least 20 s, an hour at most", whole=False)
    check_seed(seed)
    files = {path.name.removesuffix(".xodr"): path for path in sorted(Path(folder).glob("*.xodr"))}
    if unknown := sorted(set(names) - set(files)):
        raise ValueError(f"{folder}: holds no {unknown[0]}.xodr: choose of {', '.join(files) or 'other folders'}")
    if not files:
        raise ValueError(f"{folder}: no *.xodr files there: give the folder that holds them")
    find_sumo()
    tasks = [(str(files[name]), number, seconds, seed) for name in names or files for number in range(runs)]
    with WorkerPool(workers) as run:
        return Towns(tuple(tqdm(run(make_run, tasks), "towns", len(tasks), unit="simulation", disable=None)))


def make_run(task: tuple[str, int, float, int]) -> TownRun:
    """The simulation (map file, number, seconds, seed), from the cache or made now."""
    path, number, seconds, seed = Path(task[0]), task[1], task[2], task[3]
    town = path.name.removesuffix(".xodr")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    vehicles, people = DENSITIES[number % len(DENSITIES)]
    options = TrafficOptions(seconds, vehicles, people, seed=(seed * 1000 + number) % MAX_COUNT)
    content = [TRAFFIC_VERSION, SUMO_VERSION, sha256, dataclasses.asdict(options)]
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    folder = cache_folder() / "traffic"
    map_file = folder / f"{town}-{TRAFFIC_VERSION}-{sha256[:16]}.npz"
    traffic_file = folder / f"{town}-{number}-{digest[:16]}.npz"
    if not (map_file.is_file() and traffic_file.is_file()):
        road_map = read_road_map(path)
        log = road_map_log(road_map, LogMetadata(source_file=str(path)))
        traffic = simulate_town(find_sumo(), path, road_map, log, options)
        save_log(log, map_file)
        save_traffic(traffic, traffic_file)
    known = TOWNS.get(town)
    split = known.split if known is not None and known.sha256 == sha256 else ""
    count = len(_load_traffic(str(traffic_file)).egos)
    return TownRun(town, number, str(map_file), str(traffic_file), digest, count, split)
