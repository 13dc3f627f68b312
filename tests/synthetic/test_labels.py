"""Labels of synthetic scenes against their attributes."""

from __future__ import annotations

import collections
from typing import Any

import numpy as np
import pytest

from scjax.language.attributes.table import measure_attributes
from scjax.scene import AgentType
from scjax.synthetic.domains import draw_domain
from scjax.synthetic.labels import SceneLabel, label_scene
from scjax.synthetic.setting import VERSION
from scjax.synthetic.world import make_world
from tests.factories.synthetic_scenes import example_worlds, scenes_of


@pytest.fixture(scope="module")
def labeled_scenes() -> list[tuple[SceneLabel, dict[str, Any], int]]:
    """Label, attributes and number of vehicles of every scene."""
    return [
        (label_scene(world, ego), measure_attributes(scene), int((scene.agent_types == AgentType.VEHICLE).sum()))
        for world in example_worlds()
        for ego, scene in scenes_of(world)
    ]


def test_layout_labels_agree_with_attributes(labeled_scenes):
    matches = [label.layout in measured["layout"] for label, measured, _ in labeled_scenes if label.layout is not None]
    assert len(matches) > 30 and np.mean(matches) >= 0.95


def test_signal_labels_agree_with_attributes(labeled_scenes):
    matches = [
        label.signal in measured["signal"] if label.signal else not {"red", "yellow", "green"} & set(measured["signal"])
        for label, measured, _ in labeled_scenes
        if label.signal is not None
    ]
    assert len(matches) > 60 and np.mean(matches) >= 0.95


def test_scenes_have_realistic_numbers_of_vehicles(labeled_scenes):
    assert 4 < np.mean([vehicles for _, _, vehicles in labeled_scenes]) < 10


def test_roundabout_labels_agree_with_attributes():
    layouts = collections.Counter()
    for k in range(1500):
        rng = np.random.default_rng([VERSION, 8, k])
        if draw_domain(rng).draw_network_type(rng) == "roundabout":
            world = make_world(8, k)
            layouts.update(
                measure_attributes(scene)["layout"][0]
                for ego, scene in scenes_of(world)
                if label_scene(world, ego).layout == "roundabout"
            )
        if layouts.total() >= 3:
            break
    assert layouts.total() >= 3 and set(layouts) == {"roundabout"}
