"""What netconvert makes of signals; needs SUMO."""

import pytest

from scjax.towns.sumo import find_sumo
from scjax.towns.sumo_network import SumoNetwork, convert_map
from tests.factories import opendrive_files as files

LIGHT = '<signal id="{}" s="{}" t="-5" dynamic="yes" orientation="{}" type="1000001" country="OpenDRIVE"/>'
BOTH_WAYS = files.section(files.lane(1, predecessor=1, successor=1), files.lane(-1, predecessor=-1, successor=-1))
ONE_WAY = files.section(files.lane(-1, predecessor=-1, successor=-1))
QUARTER = 1.5707963267948966


def _convert(folder, *roads: str) -> SumoNetwork:
    try:
        sumo = find_sumo()
    except ValueError as error:
        pytest.skip(str(error))
    return convert_map(sumo, files.write_map(folder, *roads), folder)


def _approach(number: str, x: float, y: float, heading: float) -> str:
    """A road that begins at the junction and leads away from it, with a light at the junction."""
    plan = files.geometry(x=x, y=y, heading=heading)
    links = files.leads_to("predecessor", "9")
    return files.road(number, BOTH_WAYS, plan=plan, links=links, signals=LIGHT.format(number, 1, "-"))


def _way(number: str, start: str, goal: str, x: float, y: float, heading: float, shape: str, length: float) -> str:
    """A lane through the junction, to the right of its reference line."""
    links = files.follows("predecessor", start) + files.follows("successor", goal)
    plan = files.geometry(shape, length, x=x, y=y, heading=heading)
    return files.road(number, ONE_WAY, plan=plan, length=length, junction="9", links=links)


def _junction(*ways: tuple[str, str]) -> str:
    """Connections (approach, way) of junction 9."""
    rows = [
        f'<connection id="{k}" incomingRoad="{road}" connectingRoad="{way}" contactPoint="start">'
        '<laneLink from="1" to="-1"/></connection>'
        for k, (road, way) in enumerate(ways)
    ]
    return f'<junction id="9">{"".join(rows)}</junction>'


def test_nobody_turns_left_across_oncoming_traffic(tmp_path):
    """Roads 1 (east), 2 (west) and 3 (south): the way from the east to the south crosses the one to the east."""
    left = f'<arc curvature="{1 / 15}"/>'
    right = f'<arc curvature="{-1 / 15}"/>'
    network = _convert(
        tmp_path,
        _approach("1", 15, 0, 0.0),
        _approach("2", -15, 0, 2 * QUARTER),
        _approach("3", 0, -15, -QUARTER),
        _way("4", "1", "2", 15, 0, 2 * QUARTER, files.LINE, 30.0),
        _way("5", "2", "1", -15, 0, 0.0, files.LINE, 30.0),
        _way("6", "1", "3", 15, 0, 2 * QUARTER, left, 15 * QUARTER),
        _way("7", "2", "3", -15, 0, 0.0, right, 15 * QUARTER),
        _way("8", "3", "1", 0, -15, QUARTER, right, 15 * QUARTER),
        _way("10", "3", "2", 0, -15, QUARTER, left, 15 * QUARTER),
        _junction(("1", "4"), ("2", "5"), ("1", "6"), ("2", "7"), ("3", "8"), ("3", "10")),
    )
    (program,) = network.programs.values()
    signaled = [item for item in network.connections if item.signal is not None]
    assert len(signaled) == 6
    for state in program.states:
        green = {item.source for item in signaled if item.signal and state[item.signal[1]] in "Gg"}
        assert len(green) <= 1
    assert {item.source for item in signaled for state in program.states if state[item.signal[1]] in "Gg"} == {
        item.source for item in signaled
    }


def test_a_road_that_becomes_the_next_one_has_no_light(tmp_path):
    bend = files.geometry(f'<arc curvature="{1 / 60}"/>', 60.0, x=100.0)
    network = _convert(
        tmp_path,
        files.road("1", BOTH_WAYS, links=files.follows("successor", "2"), signals=LIGHT.format("1", 99, "+")),
        files.road("2", BOTH_WAYS, plan=bend, length=60.0, links=files.follows("predecessor", "1", "end")),
    )
    assert network.connections and not network.programs
