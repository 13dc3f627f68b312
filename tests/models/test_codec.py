"""Scene (metres) <-> NormalizedScene (unit): round trips of every preset, the official normalisation, consistent
links."""

from __future__ import annotations

import functools

import jax
import numpy as np
import pytest

from scjax.models import codec as codec
from scjax.models.codec import PRESETS, NormalizedScene, SceneCodec
from scjax.scene import STATE_COLUMNS, AgentType, Crop, Link, Scene, Signal, pad, stack, validate
from tests.factories.examples import example_scene
from tests.factories.golden import load

CROPS = list(Crop)
RAW_COLUMNS = ("x", "y", "speed", "cos", "sin", "length", "width", "z", "height")  # of the parity files


@functools.cache
def _compiled(name: str):
    return jax.jit(PRESETS[name]().normalize)


def _batch(name: str, *scenes: Scene) -> Scene:
    """What a preset sees of (up to three) scenes, always of one shape, so that each preset is compiled once."""
    preset = PRESETS[name]()
    return pad(stack([preset.select(scenes[i % len(scenes)]) for i in range(3)]), 7, 12)


def _encode(name: str, *scenes: Scene) -> NormalizedScene:
    return _compiled(name)(_batch(name, *scenes))


@functools.cache
def _decode(name: str):
    """Reads tokens back as a decoder's outputs, with these link logits."""
    preset = PRESETS[name]()

    def scene(tokens: NormalizedScene, logits) -> Scene:
        return preset.denormalize(
            tokens.agents,
            tokens.agent_types,
            tokens.agent_mask,
            tokens.lanes,
            tokens.lane_types,
            tokens.lane_mask,
            logits,
            tokens.crop,
            tokens.domain,
        )

    return jax.jit(scene)


@pytest.mark.parametrize("crop", CROPS)
@pytest.mark.parametrize("name", PRESETS)
def test_normalize_denormalize_round_trip(name, crop):
    preset = PRESETS[name]()
    examples = [example_scene(seed, agents=6, crop=crop) for seed in range(3)]
    scene, tokens = _batch(name, *examples), _encode(name, *examples)
    back = _decode(name)(tokens, 20 * np.eye(len(preset.links), dtype=np.float32)[tokens.links]).to_numpy()
    validate(back)
    known = np.array([column in preset.columns for column in STATE_COLUMNS])
    np.testing.assert_allclose(back.agents[..., known], scene.agents[..., known], rtol=1e-5, atol=2e-5)
    np.testing.assert_allclose(back.lanes[..., : preset.point_dims], scene.lanes[..., : preset.point_dims], atol=2e-5)
    assert not back.lanes[..., preset.point_dims :].any()
    for field in ("agent_types", "agent_mask", "lane_mask", "links", "crop", "domain"):
        np.testing.assert_array_equal(getattr(back, field), getattr(scene, field), err_msg=field)
    if preset.lane_classes == "signal":
        np.testing.assert_array_equal(back.signals, scene.signals)
    assert (back.agent_known == (scene.agent_mask[..., None] & known)).all()


def test_normalize_of_one_scene_equals_batch():
    examples = [example_scene(seed) for seed in range(3)]
    fused_linear = _encode("official_waymo", *examples)
    # Not jitted: NumPy in, as users call it.
    alone = PRESETS["official_waymo"]().normalize(_batch("official_waymo", *examples)[1])
    for field in ("agents", "lanes", "lane_types", "links", "agent_behind", "agent_known", "lane_known"):
        np.testing.assert_allclose(getattr(fused_linear, field)[1], getattr(alone, field), atol=1e-6, err_msg=field)


def test_normalize_gives_zero_padding():
    tokens = _encode("scjax", example_scene())
    for values, mask in ((tokens.agents, tokens.agent_mask), (tokens.lanes, tokens.lane_mask)):
        assert not np.asarray(values)[~np.asarray(mask)].any()


def test_normalize_maps_window_corners_to_one():
    for name, forward_axis in (("scjax", 0), ("official_nuplan", 0), ("official_waymo", 1)):
        scene = example_scene(lanes=1, crop=Crop.FORWARD)
        scene.lanes[0, 0, :2], scene.lanes[0, 1, :2] = (0, 32), (64, -32)
        first, second = np.asarray(_encode(name, scene).lanes)[0, 0, :2, :2]
        assert first[forward_axis] == -1 and second[forward_axis] == 1
        # y left: +32 m is +1 with x forward, and -1 on the rightward axis of a +y-forward model
        assert first[1 - forward_axis] == (1 if forward_axis == 0 else -1)


def test_waymo_codec_looks_along_y():
    preset = codec.official_waymo()
    scene = example_scene(agents=1, lanes=1)
    scene.agents[0, :6] = 10, 4, 0, 5, 1, 0  # ten metres ahead, four to the left, driving forward
    scene.agent_types[0] = AgentType.VEHICLE
    unit = dict(zip(preset.columns, np.asarray(_encode("official_waymo", scene).agents)[0, 0], strict=True))
    assert unit["x"] == pytest.approx(-4 / 32) and unit["y"] == pytest.approx(10 / 32)
    assert unit["cos"] == pytest.approx(0, abs=1e-7) and unit["sin"] == pytest.approx(1)


def test_signal_is_known_in_scenes_with_any_signal():
    scene = example_scene()
    lit = scene.signals.copy()
    lit[:] = Signal.UNKNOWN
    dark = scene.replace(signals=lit)
    lit = lit.copy()
    lit[1] = Signal.GO
    tokens = _encode("scjax", scene.replace(signals=lit), dark)
    assert (tokens.lane_type_known[0] == tokens.lane_mask[0]).all() and not tokens.lane_type_known[1].any()
    assert tokens.lane_types[0, 1] == Signal.GO and (np.delete(tokens.lane_types[0], 1) == Signal.UNKNOWN).all()


def test_partition_flags():
    scene = example_scene(agents=3, lanes=2, crop=Crop.PARTITIONED)
    scene.agents[:3, 0] = -1, 0, 1
    scene.lanes[:2, 9, 0], scene.lanes[:2, 10:, 0] = (-1, 1), 5  # the 10th point decides
    tokens = _encode("scjax", scene)
    assert np.asarray(tokens.agent_behind)[0].tolist() == [True, True, *[False] * 5]
    assert np.asarray(tokens.lane_behind)[0].tolist() == [True, *[False] * 11]
    tokens = _encode("scjax", scene.replace(crop=np.asarray(Crop.CENTERED, np.int32)))
    assert not tokens.agent_behind.any() and not tokens.lane_behind.any()


def test_select_adds_light_tokens_and_drops_other_classes():
    scene = example_scene(agents=4, lanes=3)
    scene.agent_types[:4] = list(AgentType)
    scene.signals[:3] = Signal.GO, Signal.UNKNOWN, Signal.STOP
    chosen = validate(codec.official_nuplan().select(scene))
    assert chosen.agent_types.tolist() == [AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.STATIC]
    assert chosen.signals.tolist() == [0, 0, 0, Signal.GO, Signal.STOP]
    np.testing.assert_array_equal(chosen.lanes[3:], scene.lanes[[0, 2]])
    assert chosen.links[0, 1] == Link.PREDECESSOR and not np.isin(chosen.links, [Link.LEFT, Link.RIGHT]).any()
    assert chosen.links[3, 3] == Link.SELF and not chosen.links[3, :3].any()
    assert _encode("official_nuplan", scene).lane_types[0].tolist() == [0, 0, 0, 1, 2, *[0] * 7]


@pytest.mark.parametrize("name", PRESETS)
def test_denormalize_links_are_consistent(name):
    preset = PRESETS[name]()
    tokens = _encode(name, example_scene(lanes=6))
    logits = np.random.default_rng(0).normal(0, 3, (3, 12, 12, len(preset.links))).astype(np.float32)
    made = _decode(name)(tokens, logits)
    validate(made)
    assert set(np.unique(np.asarray(made.links))) <= {int(link) for link in preset.links}


def test_denormalize_links_of_equal_logits():
    preset = codec.scjax()
    logits = np.zeros((3, 12, 12, len(preset.links)), np.float32)
    logits[..., preset.links.index(Link.LEFT)] = logits[..., preset.links.index(Link.RIGHT)] = 1
    made = _decode(preset.name)(_encode(preset.name, example_scene(1)), logits).to_numpy()
    validate(made)
    pairs = made.lane_mask[:, :, None] & made.lane_mask[:, None] & ~np.eye(12, dtype=bool)[None]
    assert set(made.links[pairs].tolist()) == {Link.LEFT, Link.RIGHT}


def test_denormalize_links_sum_both_directions():
    tokens = _encode("official_nuplan", example_scene(agents=1, lanes=2))
    logits = np.zeros((3, 12, 12, 4), np.float32)
    logits[0, 0, 1, 0], logits[0, 1, 0, 2] = 1.0, 3.0  # 0 -> 1 "none" weakly, 1 -> 0 "successor" strongly
    made = _decode("official_nuplan")(tokens, logits)
    assert made.links[0, 0, 1] == Link.PREDECESSOR and made.links[0, 1, 0] == Link.SUCCESSOR


@pytest.mark.parametrize("crop", CROPS)
def test_normalize_parity(parity_dir, crop):
    """Golden vectors §9.2: nothing is clipped on the way in; agents to [-1, 1] and lanes to 1000 on the way out."""
    inputs, outputs = (load(parity_dir, f"normalisation_{kind}.npz") for kind in ("inputs", "outputs"))
    known = {name: value for name, value in inputs.items() if name.startswith(f"type{int(crop)}/")}
    known = {name.split("/")[1]: value for name, value in known.items()}
    preset, where = codec.official_nuplan(), np.asarray(int(crop), np.int32)
    order = [RAW_COLUMNS.index(column) for column in STATE_COLUMNS]
    types = np.zeros(len(known["agents_metres"]), np.int32)  # the release has one range for all classes
    unit, metres = known["agents_unit"], known["lanes_unit"]
    made = {
        "agents_normalised": preset.normalize_agents(known["agents_metres"][:, order], types, where),
        "lanes_normalised": preset.normalize_lanes(known["lanes_metres"], where),
        "agents_unnormalised": preset.denormalize_agents(unit, types, where),
        "lanes_unnormalised": preset.denormalize_lanes(metres, where),
        "agents_unnormalised_differentiable": preset.denormalize_agents(unit, types, where),
        "lanes_unnormalised_differentiable": preset.denormalize_lanes(metres, where, clip=1.0),
    }
    stored = {name.split("/")[1] for name in outputs if name.startswith(f"type{int(crop)}/")}
    assert stored == set(made)
    for name, value in made.items():
        expected = outputs[f"type{int(crop)}/{name}"]
        np.testing.assert_allclose(value, expected, rtol=1e-6, atol=1e-6, err_msg=name)


def test_codec_rejects_contradictions():
    options = dict(
        name="mine",
        agent_types=(AgentType.VEHICLE,),
        lane_classes="none",
        links=tuple(Link),
        point_dims=2,
        agent_z=(-1.0, 1.0),
        lane_z=(-1.0, 1.0),
        speed=(0.0, 30.0),
        sizes=(((0.0, 1.0),) * 3,),
    )
    SceneCodec(**options)
    with pytest.raises(ValueError, match="1 agent types but 2 rows"):
        SceneCodec(**{**options, "sizes": options["sizes"] * 2})
    with pytest.raises(ValueError, match="point_dims"):
        SceneCodec(**{**options, "point_dims": 4})
    with pytest.raises(ValueError, match=r"unknown columns \['mass'\]"):
        SceneCodec(**{**options, "columns": ("x", "mass")})
