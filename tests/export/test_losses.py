"""What a format cannot say is listed, and what was unknown is filled in as said."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from scjax.export import EXPORTS, Losses, export_log
from scjax.export.gpudrive import gpudrive_content
from scjax.export.traffic import filled_traffic, log_with_ego
from scjax.export.waymax import waymax_arrays
from scjax.scene import NO_EGO, AgentType, Signal
from scjax.scene.agent_sizes import CLASS_SIZES
from tests.factories.exports import crossing_log
from tests.factories.logs import example_log

NATIVE = ("npz", "json", "scenarionet", "waymax", "gpudrive", "commonroad", "opendrive", "openscenario")


def _losses(log, format, folder) -> dict[str, int]:
    return export_log(log, folder / f"file{EXPORTS[format].suffix}", format).losses


def test_npz_loses_nothing(tmp_path):
    assert _losses(example_log(), "npz", tmp_path) == {}


def test_unknown_sizes_and_heights_are_filled_and_counted():
    losses = Losses()
    filled = filled_traffic(example_log(), losses)
    np.testing.assert_allclose(filled.sizes[2], [0.8, 0.8, CLASS_SIZES[AgentType.PEDESTRIAN][2]])
    np.testing.assert_allclose(filled.positions[2, 4:, 2], 10.0 + CLASS_SIZES[AgentType.PEDESTRIAN][2] / 2)
    assert not filled.positions[2, :4].any() and not filled.velocities[2, :4].any()
    assert losses["objects of unknown size, written with the mean of their class"] == 1
    assert losses["objects of unknown height, written on the nearest lane or at 0 m"] == 1


def test_objects_that_are_never_observed_are_left_out_and_counted():
    log = example_log()
    log.valid[1] = False
    losses = Losses()
    filled = filled_traffic(log, losses)
    assert filled.object_ids == ("ego", "pedestrian") and filled.ego_index == 0
    assert losses["objects that are never observed, left out"] == 1


def test_vehicle_that_is_observed_longest_takes_the_place_of_the_ego():
    log = example_log(ego_index=NO_EGO)
    log.valid[0, 7:] = False
    losses = Losses()
    assert log_with_ego(log, losses, "MetaDrive").ego_index == 1
    assert losses["no ego: the vehicle that is observed longest takes its place"] == 1


def test_steps_without_the_ego_are_cut_or_filled():
    log = example_log()
    log.valid[0, [0, 5, 9]] = False
    log.positions[0, [0, 5, 9]] = 0.0
    losses = Losses()
    cut = log_with_ego(log, losses, "MetaDrive")
    assert cut.num_steps == 8 and cut.valid[0].all()
    np.testing.assert_allclose(cut.positions[0, :, 0], 5001 + np.arange(8))
    assert losses["steps at which the ego is not observed, left out"] == 2
    assert losses["steps at which the ego is not observed, filled in"] == 1


@pytest.mark.parametrize(
    ("format", "words", "count"),
    [
        ("opendrive", "objects, left out", 3),
        ("opendrive", "signals whose states over time are left out", 1),
        ("commonroad", "heights of lanes, left out", 2),
        ("commonroad", "states of the ego, which is the planning problem", 10),
        ("scenarionet", "lanes without a height, written at that of the nearest lane or at 0 m", 1),
        ("gpudrive", "connections and neighbors of lanes, left out", 3),
    ],
)
def test_losses_name_and_count(format, words, count, tmp_path):
    assert _losses(example_log(), format, tmp_path)[words] == count


def test_limits_of_gpudrive_are_said():
    log, count, steps = crossing_log(), 70, 100
    places = np.zeros((count, steps, 3))
    places[..., 0] = np.arange(count)[:, None]
    many = dataclasses.replace(
        log,
        timestamps=0.1 * np.arange(steps),
        object_ids=tuple(map(str, range(count))),
        object_types=np.array([AgentType.STATIC] + [AgentType.VEHICLE] * (count - 1)),
        valid=np.ones((count, steps), bool),
        positions=places,
        headings=np.zeros((count, steps)),
        velocities=np.zeros((count, steps, 2)),
        sizes=np.ones((count, 3)),
        ego_index=5,
        signal_states=np.zeros((1, steps), int),
    )
    losses = Losses()
    content = gpudrive_content(many, losses, "file")
    assert losses["objects beyond 64, which the simulator does not read"] == 5
    assert losses["steps after the first 91, which the simulator does not read"] == 9
    assert losses["static objects, left out"] == 1
    assert content["objects"][0]["position"][0]["x"] == 5.0  # the ego comes first, then the nearest
    assert {item["position"][0]["x"] for item in content["objects"][1:3]} == {4.0, 6.0}


def test_gpudrive_file_has_the_keys_of_the_format(tmp_path):
    content = json.loads(export_log(crossing_log(), tmp_path / "scene.json", "gpudrive").paths[0].read_text())
    assert content.keys() == {"name", "scenario_id", "objects", "roads", "tl_states", "metadata"}
    ego, rider = content["objects"]
    steps = len(ego["position"])
    assert ego["type"] == "vehicle" and rider["type"] == "cyclist" and rider["valid"] == [False] * 5 + [True] * 15
    assert {len(ego[name]) for name in ("position", "heading", "velocity", "valid")} == {steps}
    assert ego["goalPosition"] == ego["position"][-1]
    assert {road["type"] for road in content["roads"]} == {"lane", "road_edge"}
    assert content["tl_states"]["straight"]["state"] == ["stop"] * 8 + ["go"] * 12


def test_waymax_arrays_have_the_shapes_of_a_simulator_state():
    arrays = waymax_arrays(crossing_log(), Losses())
    for name in ("x", "y", "z", "vel_x", "vel_y", "yaw", "length", "width", "height", "valid", "timestamp_micros"):
        assert arrays[f"log_trajectory.{name}"].shape == (2, 20)
    assert arrays["log_trajectory.x"].dtype == np.float32
    assert arrays["log_trajectory.timestamp_micros"][0, 1] == 100_000
    assert arrays["object_metadata.object_types"].tolist() == [1, 3]
    assert arrays["object_metadata.is_sdc"].tolist() == [True, False]
    states = {Signal.STOP: 4, Signal.GO: 6}
    assert arrays["log_traffic_light.state"][0].tolist() == [states[Signal.STOP]] * 8 + [states[Signal.GO]] * 12
    assert (arrays["roadgraph_points.types"] == 15).any()
    units = np.stack([arrays[f"roadgraph_points.dir_{name}"] for name in "xyz"])
    np.testing.assert_allclose(np.linalg.norm(units, axis=0), 1.0, atol=1e-3)
    np.testing.assert_allclose(arrays["sdc_paths.arc_length"][0], np.arange(20), atol=1e-4)


def test_edges_have_the_road_on_their_left():
    arrays = waymax_arrays(crossing_log(), Losses())
    edge = arrays["roadgraph_points.types"] == 15
    points = np.stack([arrays[f"roadgraph_points.{name}"] for name in "xy"], -1)
    left = np.stack([-arrays["roadgraph_points.dir_y"], arrays["roadgraph_points.dir_x"]], -1)
    lanes = points[~edge]
    near = [np.linalg.norm(lanes - point, axis=1).min() for point in (points + left)[edge][::7]]
    far = [np.linalg.norm(lanes - point, axis=1).min() for point in (points - left)[edge][::7]]
    assert np.mean(np.array(near) < np.array(far)) > 0.97


def test_openscenario_says_when_objects_appear(tmp_path):
    scenario, roads = export_log(crossing_log(), tmp_path / "drive.xosc", "openscenario").paths
    text = scenario.read_text()
    assert roads.name == "drive.xodr" and 'filepath="drive.xodr"' in text
    assert text.count("<Vertex ") == 35 and text.count("<AddEntityAction>") == 1
    assert text.count("<TeleportAction>") == 1 and 'state="on;off;off"' in text


@pytest.mark.parametrize("format", NATIVE)
def test_same_log_gives_the_same_bytes(format, tmp_path):
    paths = [export_log(crossing_log(), tmp_path / f"{k}" / f"a{EXPORTS[format].suffix}", format).paths for k in (1, 2)]
    if format not in ("npz", "waymax"):  # zip archives hold times
        assert [path.read_bytes() for path in paths[0]] == [path.read_bytes() for path in paths[1]]
    assert len(paths[0]) == len(paths[1])
