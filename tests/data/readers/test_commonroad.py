"""CommonRoad files: lanes, lights over time, obstacles, and damage."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.data.readers.commonroad import read_commonroad
from scjax.scene import OTHER_OBJECT, AgentType, LaneNeighbor, Signal
from tests.factories.map_files import commonroad, crossing, lanelet, obstacle


def _read(tmp_path, *elements: str):
    path = tmp_path / "scenario.xml"
    path.write_text(elements[0] if elements[0].startswith("<?xml") else commonroad(*elements))
    return read_commonroad(path)


def test_read_commonroad_reads_lanes_lights_and_traffic(tmp_path):
    log = _read(tmp_path, crossing())
    assert log.metadata.location_cluster == "DEU_Test-1" and log.metadata.notes == {"planningProblems, not read": 1}
    np.testing.assert_allclose(log.timestamps, [0, 0.2, 0.4])
    lanes = {lane.id: lane for lane in log.lanes}
    assert lanes["1"].successors == ("2", "3") and lanes["1"].lane_type == "surface_street"
    assert lanes["4"].lane_type == "not_for_cars" and not lanes["2"].left_neighbors
    assert lanes["3"].right_neighbors == (LaneNeighbor("2", 0, 1, 0, 1),)
    np.testing.assert_allclose(lanes["4"].points[:, :2], [[90, 4], [50, 4]])
    assert np.isnan(lanes["1"].points[:, 2]).all()
    assert log.signal_lane_ids == ("2",)  # the way straight on; the light names no other
    assert log.signal_states.tolist() == [[Signal.GO, Signal.STOP, Signal.STOP]]  # a cycle of 3 steps, 1 step later
    np.testing.assert_allclose(log.positions[0, :, 0], [1, 2, 3])
    np.testing.assert_allclose(log.velocities[0], [[10, 0]] * 3)
    np.testing.assert_allclose(log.sizes[0], [4.5, 2.0, np.nan])


def test_static_obstacles_stay_at_every_step(tmp_path):
    static = obstacle("5", steps=1, kind="parkedVehicle").replace("dynamicObstacle", "staticObstacle")
    log = _read(tmp_path, lanelet("1", (0, 50)), static, obstacle("6", steps=2, kind="zeppelin"))
    assert log.valid.tolist() == [[True, True], [True, True]] and not log.velocities[0].any()
    assert log.object_types.tolist() == [AgentType.VEHICLE, OTHER_OBJECT]
    assert log.metadata.unknown_words == {"obstacle type: zeppelin": 1}


def test_uncertain_states_are_taken_in_the_middle(tmp_path):
    text = obstacle("5", steps=1).replace(
        "<point><x>1</x><y>0</y></point>", "<circle><radius>1</radius><center><x>3</x><y>4</y></center></circle>"
    )
    text = text.replace(
        "<orientation><exact>0</exact>", "<orientation><intervalStart>1</intervalStart><intervalEnd>2</intervalEnd>"
    )
    log = _read(tmp_path, lanelet("1", (0, 50)), text)
    assert log.positions[0, 0, :2].tolist() == [3, 4] and log.headings[0, 0] == 1.5


def test_maps_without_traffic_have_one_step(tmp_path):
    log = _read(tmp_path, lanelet("1", (0, 50)))
    assert log.num_steps == 1 and log.num_objects == 0


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        (("<x/>",), "has no <lanelet>"),
        ((lanelet("1", (0, 9)), lanelet("1", (0, 9))), r"<lanelet id='1'>: another lanelet has the same id"),
        ((lanelet("1", (0, float("inf"))),), r"<x>: its text is inf"),
        ((lanelet("1", (0, 9)).replace("rightBound", "bound"),), r"<lanelet id='1'>: has no <rightBound>"),
        ((lanelet("1", (0, 9)).replace("<x>9</x>", "<x>nine</x>"),), "'nine', not a number"),
        ((lanelet("1", (0, 9)), obstacle("2").replace("<time><exact>1", "<time><exact>-1")), "its time step is -1"),
        (
            (lanelet("1", (0, 9)), obstacle("2").replace("<time><exact>2", "<time><exact>900000000")),
            "its time step is 9",
        ),
        (
            (lanelet("1", (0, 9)), obstacle("2").replace("<time><exact>2", "<time><exact>20000000")),
            "split the scenario",
        ),
        (
            (lanelet("1", (0, 9)), obstacle("2").replace("<point>", "<place>").replace("</point>", "</place>")),
            "neither a point",
        ),
        (("<?xml version='1.0'?><osm/>",), "the root is <osm>, not <commonRoad>"),
        (("<?xml version='1.0'?><commonRoad",), "no sound XML"),
        (
            ("<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><commonRoad>&b;</commonRoad>",),
            "defines the entity 'b'",
        ),
        (("<?xml version='1.0'?><commonRoad>" + 70 * "<a>",), "more than 64 nested elements"),
        ((lanelet("1", (0, 9)).replace("<x>9<", f"<x>{'9' * 20_000}<"),), "more than 10000 characters"),
    ],
)
def test_damaged_scenarios_are_refused_in_one_line(elements, message, tmp_path):
    with pytest.raises(ValueError, match=message) as error:
        _read(tmp_path, *elements)
    assert str(error.value).startswith(str(tmp_path / "scenario.xml")) and "\n" not in str(error.value)
