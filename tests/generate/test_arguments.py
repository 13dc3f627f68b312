"""Arguments of ``scjax.sample`` and ``Condition``: what newcomers write is read, all else is refused by name."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import scjax
from scjax.generate.conditions import Condition, Stream
from scjax.scene import Crop, Scene, unpadded
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model

COUNTS = {"num_lanes": 3, "num_agents": 2}
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        *(({"num_lanes": value}, "num_lanes") for value in (INF, NAN, [3], "3", True, 1.5, 0, 10**30, np.array([3]))),
        *(({"num_agents": value}, "num_agents") for value in ([3], object(), -1)),
        *(({"domain": value}, "domain") for value in (0.5, [0], True, -1, b"city")),
        *(({"crop": value}, "crop") for value in (7, "round", None, 0.5)),
        *(({"prompt": value}, "prompt") for value in (3, b"a road", ["a road"], "", "  ", "\ud800", "a" * 200_000)),
        ({"negative_prompt": 3}, "negative_prompt"),
        *(({"known": value}, "known") for value in (3, "scene", {})),
        *(({"streams": value}, "streams") for value in (3, [1], {"text": np.zeros((2, 3))}, {"sound": None})),
    ],
)
def test_condition_names_the_argument(fields, name):
    with pytest.raises(ValueError, match=f"Condition.{name}"):
        Condition(**fields)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        *(({"num_scenes": value}, "num_scenes") for value in (1.5, "2", 0, True, NAN)),
        *(({"num_steps": value}, "num_steps") for value in (2.5, "2", 1, 101)),
        *(({"best_of": value}, "best_of") for value in ("2", 0)),
        *(({"temperature": value}, "temperature") for value in ("1", NAN, INF, 0.0, -1.0, 1e30, [1.0])),
        *(({"guidance": value}, "guidance") for value in ([4], "4", NAN, -1e30, True)),
        *(({"sampler": value}, "sampler") for value in (3, "magic", object())),
        *(({"energy_guidance": value}, "energy_guidance") for value in ("yes", 1)),
        *(({"repair": value}, "repair") for value in ("yes", 1)),
        *(({"padded_size": value}, "padded_size") for value in (3, "ab", (1,), (1, NAN))),
        *(({"model": value}, "model") for value in (3, {})),
        ({"model": "no such folder"}, "no such folder"),
        *(({"condition": value}, "condition") for value in (3, b"road", [3], {"prompt": "a road"})),
    ],
)
def test_sample_names_the_argument(options, name):
    with pytest.raises(ValueError, match=name):
        scjax.sample(jax.random.key(0), **{"condition": Condition(**COUNTS), "model": tiny_model(), **options})


@pytest.mark.parametrize(
    "key", ["0", None, 0.5, -1, True, 2**64, np.zeros(2, np.uint32), jax.random.split(jax.random.key(0))]
)
def test_sample_refuses_odd_keys(key):
    with pytest.raises(ValueError, match="key"):
        scjax.sample(key, Condition(**COUNTS), model=tiny_model())


def test_whole_numbers_of_all_kinds_count():
    condition = Condition(num_lanes=3.0, num_agents=np.int16(2), domain=np.int32(1), crop="forward")
    assert (condition.num_lanes, condition.num_agents, condition.domain) == (3, 2, 1)
    assert condition.crop is Crop.FORWARD and type(condition.num_lanes) is int


def test_key_may_be_its_number():
    made = [scjax.sample(key, Condition(**COUNTS), model=tiny_model(), num_steps=2.0) for key in (5, jax.random.key(5))]
    assert np.array_equal(made[0].agents, made[1].agents)


def test_model_may_be_its_folder(tmp_path):
    folder = scjax.save(tiny_model(), tmp_path / "model")
    assert scjax.sample(0, Condition(**COUNTS), model=folder, num_steps=2).batch_shape == (1,)


def _changed(**changes) -> Scene:
    scene = unpadded(example_scene(2, agents=3, lanes=4))
    fields = {name: np.array(value) for name, value in scene.to_dict().items()}
    for name, (place, value) in changes.items():
        fields[name][place] = value
    return scene.replace(**fields)


@pytest.mark.parametrize(
    "changes",
    [
        {"agents": ((1, 0), NAN)},
        {"lanes": ((0, 3, 1), INF)},
        {"agents": ((1, 6), -4.0)},
        {"agents": ((1, slice(4, 6)), 0.0)},
        {"signals": (0, 17)},
        {"links": ((0, 1), 3)},
        {"agents": ((1, 0), 1e30)},
        {"domain": ((), -1)},
    ],
)
def test_known_scenes_are_validated(changes):
    with pytest.raises(ValueError, match=r"Condition\.known"):
        Condition(known=_changed(**changes))


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"tokens": np.zeros((0, 4))}, "tokens"),
        ({"tokens": np.full((2, 4), NAN)}, "tokens"),
        ({"tokens": [[1.0, 2.0]]}, "tokens"),
        ({"tokens": np.array([["a"]])}, "tokens"),
        ({"tokens": np.ones((2, 4)), "mask": np.ones(3, bool)}, "mask"),
        ({"tokens": np.ones((2, 4)), "mask": np.ones(2)}, "mask"),
        ({"tokens": np.ones((2, 4)), "positions": np.full((2, 2), INF)}, "positions"),
    ],
)
def test_stream_names_the_argument(fields, name):
    with pytest.raises(ValueError, match=f"Stream.{name}"):
        Stream(**fields)


@pytest.mark.parametrize("depth", [np.zeros((0, 0)), np.full((2, 2), NAN), "depth", np.zeros(3)])
def test_depth_maps_are_checked(depth):
    with pytest.raises(ValueError, match="depth map"):
        Stream.from_depth(depth)


def test_nan_of_a_network_is_refused():
    model = tiny_model()
    params = jax.tree.map(lambda leaf: np.full_like(leaf, NAN), model.denoiser.params)
    broken = model.with_component("denoiser", model.denoiser.config, params)
    with pytest.raises(ValueError, match="NaN or infinity"):
        scjax.sample(0, Condition(**COUNTS), model=broken, num_steps=2)
