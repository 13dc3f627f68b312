"""Reader of CommonRoad scenarios in XML, versions 2018b and 2020a: road network, traffic lights and obstacles.

Not read are traffic signs and speed limits. Planning problems, occupancy sets, phantom and environment obstacles are
not read either, but counted.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from pathlib import Path

import numpy as np

from scjax.data.readers.base import FileFormat, naming_file, read_file_bytes
from scjax.data.readers.commonroad.lanelets import read_lanelets
from scjax.data.readers.commonroad.lights import read_lights
from scjax.data.readers.commonroad.obstacles import read_obstacles
from scjax.data.readers.xml_elements import Element, has_root, parse_elements
from scjax.scene import NO_EGO, Log, LogMetadata, validate_log

COMMONROAD_DOMAIN = "commonroad"
_DEFAULT_STEP = 0.1  # s
_SKIPPED = frozenset({"trafficSign", "scenarioTags", "signalSeries", "initialSignalState"})


def read_commonroad(path: str | Path, location: str = "") -> Log:
    """The scenario in a CommonRoad file (.xml): a log without an ego; of one step if it holds no traffic.

    Args:
      location: ``LogMetadata.location_cluster``; by default the map in the benchmark's id, such as
        USA_US101-3.

    Raises:
      ValueError: naming the file, the element with its line, what is wrong with it and what to do.
    """
    path = Path(path)
    data = read_file_bytes(path)
    with naming_file(path):
        root = parse_elements(data, _SKIPPED)
        if root.tag != "commonRoad":
            raise ValueError(
                f"line {root.line}: the root is <{root.tag[:40]}>, not <commonRoad>: give a CommonRoad file"
            )
        return validate_log(_scenario(root, path, location, hashlib.sha256(data).hexdigest()))


def _scenario(root: Element, path: Path, location: str, sha256: str) -> Log:
    unknown: Counter[str] = Counter()
    notes: Counter[str] = Counter()
    lanes = read_lanelets(root, unknown)
    tracks = read_obstacles(root, unknown, notes)
    steps = tracks.states.shape[1]
    lights = read_lights(root, lanes, steps, unknown)
    step = root.number("timeStepSize", _DEFAULT_STEP)
    if not step > 0:
        raise root.fault(f"timeStepSize is {step:g} s: it must be above 0")
    valid = ~np.isnan(tracks.states[..., 0])
    states = np.where(valid[..., None], tracks.states, 0.0)
    name = root.text("benchmarkID", path.stem) or path.stem
    return Log(
        timestamps=step * np.arange(steps),
        object_ids=tracks.ids,
        object_types=tracks.types,
        valid=valid,
        positions=states[..., :3],
        headings=states[..., 3],
        velocities=states[..., 4:],
        sizes=tracks.sizes,
        ego_index=NO_EGO,
        signal_lane_ids=lights.lane_ids,
        signal_states=lights.states,
        signal_positions=lights.positions,
        lanes=tuple(lanes.values()),
        has_topology=True,
        metadata=LogMetadata(
            domain=COMMONROAD_DOMAIN,
            scene_id=name,
            location_cluster=location or _map_name(name),
            variant=f"commonroad {root.text('commonRoadVersion', '')}".strip(),
            source_file=str(path),
            source_sha256=sha256,
            unknown_words=dict(sorted(unknown.items())),
            notes=dict(sorted(notes.items())),
        ),
    )


def _map_name(benchmark: str) -> str:
    """COUNTRY_Map-1 of COUNTRY_Map-1_2_T-3."""
    match = re.match(r"[A-Z]{3}_[^_]+", benchmark.removeprefix("C-"))
    return match[0] if match else benchmark


def _is_commonroad(head: bytes) -> bool:
    return has_root(head, b"commonRoad")


COMMONROAD = FileFormat("CommonRoad", "*.xml", COMMONROAD_DOMAIN, _is_commonroad, read_commonroad, names_location=True)
