"""Runs SUMO and reads what every vehicle and person did."""

from __future__ import annotations

import array
import csv
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.towns.sumo import Sumo
from scjax.towns.sumo_network import SumoNetwork

STEP = 0.1  # s
_TELEPORT = 7.0  # m in one step; SUMO moves vehicles that are stuck
_COLUMNS = ("timestep_time", "vehicle_x", "vehicle_y", "vehicle_angle", "vehicle_pos", "vehicle_posLat")


class Drive(NamedTuple):
    """What one vehicle or person did without a break.

    Attributes:
      name: id in SUMO.
      type: of the vehicle; empty for a person.
      lanes: id of SUMO's lane at each step; empty for people.
      values: columns time [s], x, y [m], angle [deg, clockwise from north], position and lateral position [m].
    """

    name: str
    type: str
    lanes: tuple[str, ...]
    values: Float64[np.ndarray, "steps 6"]


def run_simulation(
    sumo: Sumo, network: SumoNetwork, routes: Path, folder: Path, *, seconds: float, record_from: float, seed: int
) -> list[Drive]:
    """Simulates ``seconds`` [s] of traffic and returns what was done from ``record_from`` on.

    Raises:
      ValueError: SUMO fails.
    """
    out = folder / "traffic.csv"
    attributes = "x,y,angle,pos,lane,posLat,type"
    arguments = [
        *("--net-file", network.path, "--route-files", routes, "--step-length", STEP, "--end", seconds),
        *("--seed", seed, "--default.speeddev", 0.1, "--lanechange.duration", 3.0, "--time-to-teleport", 90),
        *("--ignore-route-errors", "--no-step-log", "--no-warnings", "--collision.action", "warn"),
        *("--fcd-output", out, "--fcd-output.attributes", attributes, "--device.fcd.begin", record_from),
        *("--pedestrian.striping.jamtime", 20, "--xml-validation", "never"),
    ]
    sumo.run("sumo", list(map(str, arguments)), folder)
    drives = list(_read_drives(out))
    out.unlink()
    return drives


def _read_drives(path: Path) -> Iterator[Drive]:
    numbers: dict[tuple[str, str], array.array] = {}
    lanes: dict[tuple[str, str], list[str]] = {}
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file, delimiter=";")
        header = next(reader, [])
        if not header:
            return
        name, kind, lane = (header.index(f"vehicle_{word}") for word in ("id", "type", "lane"))
        columns = [header.index(column) for column in _COLUMNS]
        for row in reader:
            if not row[name]:
                continue
            on = sys.intern(row[lane])
            key = (row[name], row[kind] if on else "")
            if key not in numbers:
                numbers[key], lanes[key] = array.array("d"), []
            numbers[key].extend(float(row[column] or 0) for column in columns)
            lanes[key].append(on)
    for key, flat in numbers.items():
        values = np.frombuffer(flat).reshape(-1, len(_COLUMNS))
        time, x, y = np.diff(values[:, :3], axis=0).T
        breaks = np.flatnonzero((time > 1.5 * STEP) | (np.hypot(x, y) > _TELEPORT)) + 1
        for part in np.split(np.arange(len(values)), breaks):
            if len(part) > 1:
                on = tuple(lanes[key][part[0] : part[-1] + 1]) if key[1] else ()
                yield Drive(*key, on, values[part])
