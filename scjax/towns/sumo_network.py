"""SUMO's reading of an OpenDRIVE map: its lanes, connections and signal programs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float64

from scjax.towns.sumo import Sumo

_OPTIONS = (
    "--output.original-names",
    "--offset.disable-normalization",
    "--opendrive.curve-resolution=1",
    "--crossings.guess",
    "--walkingareas",
    "--tls.discard-simple",  # no lights where one road only becomes the next one
    "--tls.layout=incoming",  # one approach after the other, so that nobody turns left across oncoming traffic
)
_DISCARDED = ("parking", "bidirectional", "stop")  # lane types that no way leads through
_CARS, _PEOPLE = "passenger", "pedestrian"


@dataclasses.dataclass(frozen=True)
class SumoLane:
    """A lane of a SUMO network.

    Attributes:
      id: EDGE_INDEX.
      edge: id of its edge.
      origin: road and lane id in the OpenDRIVE file; None where SUMO does not say.
      points: centerline [m], in the frame of the file.
      length: by which SUMO counts positions [m]; that of the centerline may differ a little.
      is_internal: whether it lies in a junction.
      has_cars, has_people: who may use it.
    """

    id: str
    edge: str
    origin: tuple[str, int] | None
    points: Float64[np.ndarray, "points 2"]
    length: float
    is_internal: bool
    has_cars: bool
    has_people: bool


@dataclasses.dataclass(frozen=True)
class SumoConnection:
    """A way from a lane into another one.

    Attributes:
      source, target: ids of lanes outside of junctions.
      via: ids of the lanes in the junction, in order.
      signal: id of the signal program and index of its state; None without a signal.
    """

    source: str
    target: str
    via: tuple[str, ...]
    signal: tuple[str, int] | None


@dataclasses.dataclass(frozen=True)
class SignalProgram:
    """A program of signals with fixed times.

    Attributes:
      offset: [s].
      durations: of the phases [s].
      states: of each phase, one letter for each connection.
    """

    offset: float
    durations: Float64[np.ndarray, " phases"]
    states: tuple[str, ...]

    def states_at(self, times: Float64[np.ndarray, " steps"]) -> list[str]:
        """The state at each time [s]."""
        ends = np.cumsum(self.durations)
        rows = np.searchsorted(ends, (times - self.offset) % ends[-1], side="right")
        return [self.states[min(row, len(self.states) - 1)] for row in rows]


@dataclasses.dataclass(frozen=True)
class SumoNetwork:
    """A network.

    Attributes:
      path: its file.
      lanes: by id, for cars and for people.
      connections: of lanes for cars.
      programs: signal programs by id.
    """

    path: Path
    lanes: dict[str, SumoLane]
    connections: list[SumoConnection]
    programs: dict[str, SignalProgram]


def convert_map(sumo: Sumo, opendrive: Path, folder: Path) -> SumoNetwork:
    """Converts an OpenDRIVE file with netconvert; ``folder`` receives net.xml.

    Sidewalks become lanes for people, with crossings at junctions.

    Raises:
      ValueError: netconvert refuses the file.
    """
    discarded = "".join(f'<type id="{word}" discard="true"/>' for word in _DISCARDED)
    (folder / "types.xml").write_text(f"<types>{discarded}</types>", encoding="utf-8")
    maps = sumo.home / "data" / "typemap"
    types = [
        maps / "opendriveNetconvert.typ.xml",
        maps / "opendriveNetconvertPedestrians.typ.xml",
        folder / "types.xml",
    ]
    path = folder / "net.xml"
    arguments = ["--opendrive-files", opendrive.resolve(), "--output-file", path, *_OPTIONS]
    sumo.run("netconvert", [*arguments, "--type-files", ",".join(map(str, types))], folder)
    return read_network(path)


def read_network(path: Path) -> SumoNetwork:
    """The network in a net.xml file that netconvert wrote."""
    root = ElementTree.parse(path).getroot()
    lanes = {
        lane.id: lane
        for edge in root.iter("edge")
        for lane in (_read_lane(edge, element) for element in edge.iter("lane"))
    }
    programs = {item.get("id", ""): _read_program(item) for item in root.iter("tlLogic")}
    return SumoNetwork(path, lanes, _read_connections(root, lanes), programs)


def _read_lane(edge: ElementTree.Element, element: ElementTree.Element) -> SumoLane:
    name = next((item.get("value", "") for item in element.iter("param") if item.get("key") == "origId"), "")
    road, _, lane = name.partition(" ")[0].rpartition("_")
    points = [[float(v) for v in point.split(",")[:2]] for point in element.get("shape", "").split()]
    return SumoLane(
        id=element.get("id", ""),
        edge=edge.get("id", ""),
        origin=(road, int(lane)) if road else None,
        points=np.array(points, np.float64).reshape(-1, 2),
        length=float(element.get("length", 0)),
        is_internal=edge.get("function") == "internal",
        has_cars=edge.get("function") in (None, "internal") and _allows(element, _CARS),
        has_people=edge.get("function") is None and _allows(element, _PEOPLE),
    )


def _allows(lane: ElementTree.Element, user: str) -> bool:
    allowed, refused = lane.get("allow"), lane.get("disallow", "").split()
    return user in allowed.split() if allowed is not None else user not in refused and "all" not in refused


def _read_connections(root: ElementTree.Element, lanes: dict[str, SumoLane]) -> list[SumoConnection]:
    onward: dict[str, str] = {}  # lane in a junction -> the lane in the junction behind it
    rows = []
    for item in root.iter("connection"):
        source = f"{item.get('from')}_{item.get('fromLane')}"
        target = f"{item.get('to')}_{item.get('toLane')}"
        via = item.get("via")
        if source in lanes and lanes[source].is_internal:
            if via:
                onward[source] = via
        elif source in lanes and target in lanes and lanes[source].has_cars and lanes[target].has_cars:
            signal = item.get("tl")
            rows.append((source, target, via, (signal, int(item.get("linkIndex", 0))) if signal else None))
    connections = []
    for source, target, via, signal in rows:
        chain = []
        while via and via not in chain:
            chain.append(via)
            via = onward.get(via)
        connections.append(SumoConnection(source, target, tuple(chain), signal))
    return connections


def _read_program(element: ElementTree.Element) -> SignalProgram:
    phases = element.findall("phase")
    durations = np.array([float(phase.get("duration", 0)) for phase in phases])
    states = tuple(phase.get("state", "") for phase in phases)
    return SignalProgram(float(element.get("offset", 0)), durations, states)
