"""``scjax.sample``: shapes, determinism, known elements, buckets; on an untrained model."""

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax import Guidance
from scjax.diffusion.energies import connection_energy, overlap_energy
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.diffusion.samplers import DDIM
from scjax.generate import compiled as programs
from scjax.generate.conditions import Condition
from scjax.models.denoiser.config import TextCondition
from scjax.scene import Crop, Link, unpadded, validate
from scjax.scene.per_type import PerType
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model

STEPS = 3


@pytest.fixture(scope="module")
def model():
    return tiny_model()


def draw(model, condition=None, n=1, seed=0, **options):
    return scjax.sample(jax.random.key(seed), condition, model=model, n=n, steps=STEPS, **options)


def test_scenes_are_valid_and_in_metres(model):
    scenes = draw(model, n=3)
    validate(scenes)
    assert scenes.batch_shape == (3,)
    assert np.abs(scenes.agents[..., :2]).max() <= 32.001


def test_counts_domain_and_layout_are_met(model):
    scenes = draw(model, Condition(num_lanes=7, num_agents=4, domain="there", crop=Crop.FORWARD), n=2)
    assert scenes.num_lanes.tolist() == [7, 7] and scenes.num_agents.tolist() == [4, 4]
    assert scenes.domain.tolist() == [1, 1] and scenes.crop.tolist() == [2, 2]


def test_a_scene_depends_on_its_own_key_only(model):
    condition = Condition(num_lanes=6, num_agents=5)
    many, few = draw(model, condition, n=3), draw(model, condition, n=1)
    chex.assert_trees_all_close(many[0].to_dict(), few[0].to_dict(), atol=2e-3)
    assert not np.allclose(many[0].lanes, many[1].lanes)
    chex.assert_trees_all_equal(draw(model, condition, n=3).to_dict(), many.to_dict())


def test_known_elements_come_back_unchanged(model):
    known = unpadded(example_scene(2, agents=3, lanes=4))
    scene = draw(model, Condition(known=known, num_lanes=9, num_agents=6))[0]
    validate(scene)
    assert (scene.num_lanes, scene.num_agents) == (9, 6)
    for name in ("agents", "agent_types", "agent_known"):
        assert np.array_equal(getattr(scene, name)[:3], getattr(known, name)), name
    for name in ("lanes", "lane_known", "signals"):
        assert np.array_equal(getattr(scene, name)[:4], getattr(known, name)), name
    assert np.array_equal(scene.links[:4, :4], known.links)


def test_lane_conditioned(model):
    known = unpadded(example_scene(3, agents=2, lanes=5))
    roads = known.replace(
        agents=known.agents[:0], agent_types=known.agent_types[:0], agent_mask=known.agent_mask[:0],
        agent_known=known.agent_known[:0],
    )  # fmt: skip
    scene = draw(model, Condition(known=roads, num_lanes=5, num_agents=7))[0]
    assert np.array_equal(scene.lanes, roads.lanes) and np.array_equal(scene.links, roads.links)
    assert scene.num_agents == 7


def test_one_program_a_bucket(model, monkeypatch):
    programs.sampling_program.cache_clear()
    original = programs.sample_latents
    traced = chex.assert_max_traces(lambda *args, **kwargs: original(*args, **kwargs), n=1)
    monkeypatch.setattr(programs, "sample_latents", traced)
    for seed, (lanes, weight) in enumerate(((3, 2.0), (9, 3.0), (15, 4.0))):
        draw(model, Condition(num_lanes=lanes, num_agents=4), seed=seed, guidance=weight, temperature=weight / 4)
    programs.sampling_program.cache_clear()


def test_known_elements_and_numbers_hold_for_another_sampler(model):
    known = unpadded(example_scene(2, agents=3, lanes=4))
    condition = Condition(known=known, num_lanes=9, num_agents=6)
    scene, other = (draw(model, condition, sampler=sampler)[0] for sampler in (DDIM(eta=0.5), "ddpm"))
    validate(scene)
    assert (scene.num_lanes, scene.num_agents) == (9, 6)
    assert np.array_equal(scene.agents[:3], known.agents) and np.array_equal(scene.lanes[:4], known.lanes)
    assert not np.allclose(scene.lanes, other.lanes)


def test_steering_closes_joints_and_parts_boxes_but_moves_nothing_known(model):
    """An untrained model's scenes are heaps of boxes and lanes: steered ones are less so, with the same links."""
    known = unpadded(example_scene(2, agents=3, lanes=4))
    condition = Condition(known=known, num_lanes=9, num_agents=6)
    strong = EnergyGuidance(gradient_steps=30, max_sigma=0.0, agent_step_size=0.02, lane_step_size=0.005)
    plain, led = (draw(model, condition, n=2, energy_guidance=energy_guidance) for energy_guidance in (False, strong))
    validate(led)
    assert np.array_equal(led.agents[0, :3], known.agents) and np.array_equal(led.lanes[1, :4], known.lanes)
    linked = led.replace(links=plain.links)
    before, after = (float((connection_energy(scenes) + overlap_energy(scenes)).sum()) for scenes in (plain, linked))
    assert after < 0.8 * before
    many, one = (draw(model, condition, n=n, energy_guidance=EnergyGuidance(gradient_steps=2)) for n in (2, 1))
    np.testing.assert_allclose(one.agents[0], many.agents[0], atol=5e-3)


def test_steering_is_the_models_unless_told(model):
    condition = Condition(num_lanes=5, num_agents=3)
    plain, told = draw(model, condition), draw(model, condition, energy_guidance=True)
    with_energy_guidance = dataclasses.replace(model, energy_guidance=EnergyGuidance())
    assert not np.array_equal(plain.lanes, told.lanes)
    chex.assert_trees_all_equal(draw(with_energy_guidance, condition).to_dict(), told.to_dict())
    chex.assert_trees_all_equal(draw(with_energy_guidance, condition, energy_guidance=False).to_dict(), plain.to_dict())


def test_the_default_fits_what_the_network_estimates(model):
    condition = Condition(num_lanes=5, num_agents=3)
    named = draw(model, condition, sampler="ddpm")
    chex.assert_trees_all_equal(draw(model, condition).to_dict(), named.to_dict())
    flow = tiny_model(prediction="flow")
    validate(draw(flow, condition))
    chex.assert_trees_all_equal(draw(flow, condition).to_dict(), draw(flow, condition, sampler="heun").to_dict())
    with pytest.raises(ValueError, match=r"estimates flow: choose one of dpm\+\+, euler, heun"):
        draw(flow, condition, sampler="ddpm")
    with pytest.raises(ValueError, match=r"no sampler 'plms': choose one of ddpm, ddim, dpm\+\+"):
        draw(model, condition, sampler="plms")


def test_temperature_is_the_models_unless_told(model):
    condition = Condition(num_lanes=5, num_agents=3)
    cold = dataclasses.replace(model, temperature=PerType(agents=0.5, lanes=0.5))
    told = draw(model, condition, temperature=0.5)
    chex.assert_trees_all_equal(draw(cold, condition).to_dict(), told.to_dict())
    chex.assert_trees_all_equal(
        draw(cold, condition, temperature=model.temperature).to_dict(), draw(model, condition).to_dict()
    )
    assert not np.allclose(told.agents, draw(model, condition).agents, atol=0.05)
    with pytest.raises(ValueError, match="temperature must be positive"):
        draw(model, condition, temperature=PerType(agents=1.0, lanes=0.0))


def test_guidance_with_options(model):
    condition = Condition(num_lanes=5, num_agents=3)
    plain, constant = draw(model, condition, guidance=1.0), draw(model, condition, guidance=3.0)
    everywhere = draw(model, condition, guidance=Guidance(3.0, interval=(0.0, 99.0)))
    np.testing.assert_allclose(everywhere.lanes, constant.lanes, atol=2e-3)
    led_back = draw(model, condition, guidance=Guidance(3.0, rescale=1.0))
    assert not np.allclose(led_back.lanes, constant.lanes, atol=0.05)
    assert not np.allclose(plain.lanes, constant.lanes, atol=0.05)


def test_text_tokens_and_guidance_change_the_scene():
    model = tiny_model(TextCondition(width=6))
    rng, options = np.random.default_rng(0), {"num_lanes": 4, "num_agents": 3}
    tokens = rng.normal(size=(5, 6)).astype(np.float32)
    plain, told = draw(model, Condition(**options)), draw(model, Condition(tokens=tokens, **options))
    assert not np.allclose(plain.lanes, told.lanes)
    masked = np.concatenate([tokens, np.full((2, 6), np.nan, np.float32)])
    same = draw(model, Condition(tokens=masked, token_mask=np.arange(7) < 5, **options))
    chex.assert_trees_all_close(same.lanes, told.lanes, atol=1e-3)


def test_reconstruct_keeps_count_and_order(model):
    scenes = [unpadded(example_scene(seed, agents=3 + seed, lanes=4 + seed)) for seed in range(3)]
    for scene, decoded in zip(scenes, scjax.reconstruct(model, scenes), strict=True):
        assert decoded.agents.shape == scene.agents.shape and decoded.lanes.shape == scene.lanes.shape
        assert (np.diag(decoded.links) == Link.SELF).all()


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (Condition(num_lanes=101, num_agents=3), "num_lanes is 101"),
        (Condition(domain="mars"), "mars.*here, there"),
        (Condition(domain=7), "outside 0..1"),
        (Condition(tokens=np.zeros((3, 4), np.float32)), "unconditional"),
        (Condition(known=unpadded(example_scene(lanes=6)), num_lanes=5), "known elements"),
    ],
)
def test_bad_requests(model, condition, message):
    with pytest.raises(ValueError, match=message):
        draw(model, condition)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"num_lanes": 0}, "num_lanes"),
        ({"num_agents": -3}, "num_agents"),
        ({"tokens": np.zeros(3)}, "rank 1"),
        ({"known": example_scene().replace(**{k: v[None] for k, v in example_scene().to_dict().items()})}, "single"),
    ],
)
def test_bad_conditions(fields, message):
    with pytest.raises(ValueError, match=message):
        Condition(**fields)
