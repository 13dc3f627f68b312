"""An OpenDRIVE map -> its log without traffic, and traffic on it by SUMO."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scjax.data.lane_graph import build_graph, index_segments, nearest_lane
from scjax.data.readers.opendrive.lane_lines import LaneKey
from scjax.data.readers.opendrive.road_map import RoadMap
from scjax.scene import Log, Signal
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.towns.demand import Demand, vehicle_sizes, write_demand
from scjax.towns.egos import choose_egos
from scjax.towns.lane_paths import LanePath, match_lanes
from scjax.towns.simulation import STEP, Drive, run_simulation
from scjax.towns.sumo import Sumo
from scjax.towns.sumo_network import SumoNetwork, convert_map
from scjax.towns.town_traffic import TownTraffic, collect_traffic
from scjax.towns.tracks import Track, drive_track, walk_track

WARM_UP = 60.0  # s before the recording
_HISTORY = 30.0  # s before the recording that boxes follow
_ASIDE, _MAX_ASIDE = 0.25, 0.3  # m from the middle of a lane: standard deviation and most
_LANE_WIDTH = 3.3  # m that a box and its way from side to side fill at most
_LETTERS = {
    **dict.fromkeys("Gg", Signal.GO),
    **dict.fromkeys("Yy", Signal.CAUTION),
    **dict.fromkeys("rus", Signal.STOP),
}


@dataclasses.dataclass(frozen=True)
class TrafficOptions:
    """What is simulated.

    Attributes:
      seconds: length of the recording [s].
      vehicles_per_km: of lanes.
      people_per_km: of sidewalks.
      egos: at each moment, at most.
      seed: of all that is drawn.
    """

    seconds: float = 120.0
    vehicles_per_km: float = 8.0
    people_per_km: float = 6.0
    egos: int = 12
    seed: int = 0


def simulate_town(sumo: Sumo, opendrive: Path, road_map: RoadMap, log: Log, options: TrafficOptions) -> TownTraffic:
    """Traffic in a town.

    Args:
      opendrive: file of the map.
      road_map, log: what our reader made of it.

    Raises:
      ValueError: SUMO fails, or has no lane that lies on ours.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        network = convert_map(sumo, opendrive, folder)
        paths = match_lanes(network, road_map, lambda key: road_map.lane_types[key] not in NO_CAR_LANE_TYPES)
        if not paths:
            raise ValueError(f"{opendrive}: no lane of SUMO lies on a lane of ours: leave this map out")
        demand = Demand(options.vehicles_per_km, options.people_per_km, WARM_UP + options.seconds, options.seed)
        routes = write_demand(network, demand, folder)
        drives = run_simulation(
            sumo,
            network,
            routes,
            folder,
            seconds=WARM_UP + options.seconds,
            record_from=WARM_UP - _HISTORY,
            seed=options.seed,
        )
    steps = round(options.seconds / STEP)
    lanes, states = signal_states(network, paths, road_map, WARM_UP + STEP * np.arange(steps))
    tracks = _make_tracks(
        drives, paths, vehicle_sizes(options.seed), _height_of(log), _keeps_right(road_map), options.seed
    )
    traffic = collect_traffic(tracks, lanes, states)
    return dataclasses.replace(traffic, egos=choose_egos(traffic, options.egos, options.seed))


def signal_states(
    network: SumoNetwork, paths: dict[str, LanePath], road_map: RoadMap, times: np.ndarray
) -> tuple[list[str], np.ndarray]:
    """Ids of the lanes that signals control, and the ``Signal`` of each at every time [lanes, steps].

    A signal controls all lanes in the junction of each way that SUMO controls.
    """
    texts = {name: program.states_at(times) for name, program in network.programs.items()}
    states: dict[LaneKey, np.ndarray] = {}
    for connection in network.connections:
        if connection.signal is None or not connection.via or connection.via[0] not in paths:
            continue
        name, index = connection.signal
        behind = len(paths[connection.source].keys)
        way = [key for key in paths[connection.via[0]].keys[behind - 1 :] if road_map.lines[key].in_junction]
        if name not in texts or index >= len(texts[name][0]):
            continue
        letters = np.array([_LETTERS.get(text[index], Signal.UNKNOWN) for text in texts[name]], np.int8)
        for key in way:
            states.setdefault(key, letters)
    table = np.array(list(states.values()), np.int8).reshape(len(states), len(times))
    return [str(key) for key in states], table


def _make_tracks(
    drives: list[Drive],
    paths: dict[str, LanePath],
    sizes: dict[str, tuple[float, float, float]],
    height_at: Callable[[np.ndarray], np.ndarray],
    side: float,
    seed: int,
) -> list[Track]:
    rng = np.random.default_rng([seed, 17])
    tracks: list[Track] = []
    for drive in drives:
        if drive.type:
            most = np.clip((_LANE_WIDTH - sizes[drive.type][1]) / 3, 0.0, _MAX_ASIDE)
            aside = float(np.clip(rng.normal(0.0, _ASIDE), -most, most))
            tracks += drive_track(drive, paths, sizes[drive.type], WARM_UP, side, aside)
        elif (walk := walk_track(drive, height_at, WARM_UP)) is not None:
            tracks.append(walk)
    return tracks


def _height_of(log: Log) -> Callable[[np.ndarray], np.ndarray]:
    index = index_segments(build_graph(log), max_length=5.0)
    return lambda xy: nearest_lane(index, xy)[2]


def _keeps_right(road_map: RoadMap) -> float:
    """1 if most lanes to the right of the reference line drive along it, -1 if not."""
    right = [line.lane.forward for key, line in road_map.lines.items() if key.lane < 0]
    return 1.0 if not right or np.mean(right) >= 0.5 else -1.0
