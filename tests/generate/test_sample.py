"""``scjax.sample``: shapes, determinism, known elements, buckets; on an untrained model."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax import Guidance
from scjax.diffusion import denoise_fn
from scjax.diffusion.energies import connection_energy, overlap_energy
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.diffusion.samplers import DDIM
from scjax.generate import compiled
from scjax.generate.conditions import Condition, Stream
from scjax.generate.scene_spec import specify_scenes
from scjax.models.denoiser.config import TextCondition
from scjax.nn.stored_program import StoredProgram
from scjax.scene import Crop, unpadded, validate
from scjax.scene.per_type import PerType
from scjax.train.fit_position_head import position_targets
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model

COUNTS = {"num_lanes": 5, "num_agents": 3}
PROGRAMS = [value for name, value in vars(compiled).items() if name.endswith("_program")]


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Scenes have one of two sizes: most of the time of these tests is compiling."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.generate.batching.BUCKETS", ((16, 28), (61, 100)))
        yield


@pytest.fixture(scope="module")
def model():
    return tiny_model()


@pytest.fixture(scope="module")
def known():
    return unpadded(example_scene(2, agents=3, lanes=4))


def sample(model, condition=None, num_scenes=1, seed=0, num_steps=2, **options):
    options |= {"num_scenes": num_scenes, "num_steps": num_steps}
    return scjax.sample(jax.random.key(seed), condition, model=model, **options)


def assert_known(scene, known):
    """The first agents and lanes of ``scene`` are exactly those of ``known``."""
    agents, lanes = len(known.agent_mask), len(known.lane_mask)
    for name in ("agents", "agent_types", "agent_known"):
        assert np.array_equal(getattr(scene, name)[:agents], getattr(known, name)), name
    for name in ("lanes", "lane_known", "signals"):
        assert np.array_equal(getattr(scene, name)[:lanes], getattr(known, name)), name
    assert np.array_equal(scene.links[:lanes, :lanes], known.links)


def test_sample_scenes_are_valid_and_in_meters(model):
    scenes = sample(model, num_scenes=3)
    validate(scenes)
    assert scenes.batch_shape == (3,)
    assert np.abs(scenes.agents[..., :2]).max() <= 32.001


def test_sample_meets_counts_domain_and_crop(model):
    condition = Condition(num_lanes=7, num_agents=4, domain="there", crop=Crop.FORWARD)
    scenes = sample(model, condition, num_scenes=2)
    assert scenes.num_lanes.tolist() == [7, 7] and scenes.num_agents.tolist() == [4, 4]
    assert scenes.domain.tolist() == [1, 1] and scenes.crop.tolist() == [2, 2]


def test_sample_depends_on_the_scenes_own_key_only(model):
    condition = Condition(num_lanes=6, num_agents=5)
    many, few = sample(model, condition, num_scenes=3), sample(model, condition)
    chex.assert_trees_all_close(many[0].to_dict(), few[0].to_dict(), atol=2e-3)
    assert not np.allclose(many[0].lanes, many[1].lanes)
    chex.assert_trees_all_equal(sample(model, condition, num_scenes=3).to_dict(), many.to_dict())


def test_sample_of_a_list_equals_single_calls(model):
    conditions = [Condition(num_lanes=6, num_agents=5), Condition(num_lanes=9, num_agents=2), Condition()]
    scenes = sample(model, conditions)
    assert isinstance(scenes, list) and len(scenes) == 3
    for i, condition in enumerate(conditions):
        single = sample(model, condition, num_scenes=3)
        chex.assert_trees_all_close(scenes[i].to_dict(), unpadded(single[i]).to_dict(), atol=2e-3)


def test_sample_of_a_list_has_num_scenes_of_each(model):
    first, second = Condition(num_lanes=6, num_agents=5), Condition(num_lanes=9, num_agents=2)
    scenes = sample(model, [first, second], num_scenes=2)
    assert [int(scene.num_lanes) for scene in scenes] == [6, 6, 9, 9]
    repeated = sample(model, [first, first, second, second])
    for one, other in zip(scenes, repeated, strict=True):
        chex.assert_trees_all_equal(one.to_dict(), other.to_dict())
    assert sample(model, []) == []


def test_sample_says_how_far_it_is(model):
    calls = []
    conditions = [Condition(num_lanes=6, num_agents=5)] * 5  # two batches
    scenes = sample(model, conditions, progress=lambda done, total: calls.append((done, total)))
    done, totals = zip(*calls, strict=True)
    assert done[0] == 0 and list(done) == sorted(done) and {done[-1]} == set(totals) == {4}
    for one, quiet in zip(scenes, sample(model, conditions), strict=True):
        chex.assert_trees_all_equal(one.to_dict(), quiet.to_dict())


def test_specs_stand_for_their_conditions(model, known):
    conditions = [Condition(num_lanes=6, num_agents=5), Condition(known=known, num_lanes=9, num_agents=6)]
    specs = specify_scenes(conditions, model)
    assert specify_scenes([specs[0], conditions[1]], model)[0] is specs[0]
    for one, other in zip(sample(model, specs, 2), sample(model, conditions, 2), strict=True):
        chex.assert_trees_all_equal(one.to_dict(), other.to_dict())


def test_sample_keeps_known_elements(model, known):
    scene = sample(model, Condition(known=known, num_lanes=9, num_agents=6))[0]
    validate(scene)
    assert (scene.num_lanes, scene.num_agents) == (9, 6)
    assert_known(scene, known)


def test_sample_keeps_known_elements_when_it_repairs(model, known):
    condition = Condition(known=known, num_lanes=9, num_agents=6)
    plain, repaired = sample(model, condition)[0], sample(model, condition, repair=True)[0]
    expected = scjax.repair(plain, known_agents=3, known_lanes=4)
    chex.assert_trees_all_equal(repaired.to_dict(), expected.to_dict())
    for name in ("agents", "lanes"):
        assert np.array_equal(getattr(repaired, name)[:3], getattr(known, name)[:3]), name


def test_sample_adds_traffic_to_known_lanes(model):
    scene = unpadded(example_scene(3, agents=2, lanes=5))
    roads = scene.replace(
        agents=scene.agents[:0],
        agent_types=scene.agent_types[:0],
        agent_mask=scene.agent_mask[:0],
        agent_known=scene.agent_known[:0],
    )
    result = sample(model, Condition(known=roads, num_lanes=5, num_agents=7))[0]
    assert np.array_equal(result.lanes, roads.lanes) and np.array_equal(result.links, roads.links)
    assert result.num_agents == 7


def test_sample_compiles_each_program_once_for_a_bucket(model, monkeypatch):
    """Another number of lanes, another scale of guidance or another temperature is the same program."""
    for program in PROGRAMS:
        program.cache_clear()
    traced = chex.assert_max_traces(denoise_fn.denoise_fn, n=1)
    monkeypatch.setattr(compiled, "denoise_fn", traced)
    for seed, (lanes, scale) in enumerate(((9, 2.0), (12, 3.0), (15, 4.0))):
        condition = Condition(num_lanes=lanes, num_agents=4)
        sample(model, condition, seed=seed, guidance=scale, temperature=scale / 4)
    for program in PROGRAMS:
        program.cache_clear()


def test_sample_of_a_second_process_traces_nothing(model, monkeypatch, tmp_path):
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path))
    scenes = []
    for _ in range(2):
        for program in PROGRAMS:
            program.cache_clear()
        scenes.append(sample(model, Condition(**COUNTS)))
        monkeypatch.setattr(StoredProgram, "lower", None)
    chex.assert_trees_all_equal(*(scene.to_dict() for scene in scenes))
    for program in PROGRAMS:
        program.cache_clear()


def test_sampler_changes_the_scene_but_no_known_element(model, known):
    condition = Condition(known=known, num_lanes=9, num_agents=6)
    scene, other = (sample(model, condition, sampler=sampler)[0] for sampler in (DDIM(eta=0.5), "ddpm"))
    validate(scene)
    assert (scene.num_lanes, scene.num_agents) == (9, 6)
    assert np.array_equal(scene.agents[:3], known.agents) and np.array_equal(scene.lanes[:4], known.lanes)
    assert not np.allclose(scene.lanes, other.lanes)


@pytest.fixture(scope="module")
def pointed_model():
    """A model whose position heads are fitted to its decoder, by least squares on random latents."""
    model = tiny_model(seed=1, relative_geometry=True)  # of seed 0 a link head is undecided, and rounding decides
    config = model.denoiser.config
    rng = np.random.default_rng(0)
    masks = PerType(agents=np.ones((64, 4), bool), lanes=np.ones((64, 6), bool))
    widths = PerType(agents=config.agent_latent, lanes=config.lane_latent)
    latents = jax.tree.map(lambda mask, width: rng.normal(size=(*mask.shape, width)).astype(np.float32), masks, widths)
    none = np.zeros(64, np.int32)
    decode = compiled.decode_program(model.codec, model.autoencoder.config)
    scenes = decode(
        model.autoencoder.params["decoder"], model.latents.mean, model.latents.std, latents, masks, none, none, None
    )
    targets, heads = position_targets(scenes), {}
    for name, head in model.denoiser.params["position_heads"].items():
        inputs = getattr(latents, name).reshape(-1, getattr(widths, name))
        inputs = np.concatenate([inputs, np.ones((len(inputs), 1), np.float32)], 1)
        weights = np.linalg.lstsq(inputs, targets[name].reshape(len(inputs), -1), rcond=None)[0].astype(np.float32)
        heads[name] = jax.tree.map(np.zeros_like, head) | {"skip": {"kernel": weights[:-1], "bias": weights[-1]}}
    return model.with_component("denoiser", config, {**model.denoiser.params, "position_heads": heads})


def sample_guided(model, condition, energy_guidance, num_scenes=1):
    return sample(model, condition, num_scenes, num_steps=3, energy_guidance=energy_guidance)


def test_energy_guidance_lowers_the_energy(pointed_model, known):
    """An untrained model's scenes are heaps of boxes and lanes; guided ones are less so, with the same links."""
    condition = Condition(known=known, num_lanes=9, num_agents=6)
    strong = EnergyGuidance(gradient_steps=60, max_sigma=0.0, agent_step_size=0.02, lane_step_size=0.005)
    plain, guided = (sample_guided(pointed_model, condition, option, num_scenes=2) for option in (False, strong))
    validate(guided)
    assert np.array_equal(guided.agents[0, :3], known.agents) and np.array_equal(guided.lanes[1, :4], known.lanes)
    linked = guided.replace(links=plain.links)
    before, after = (float((connection_energy(scenes) + overlap_energy(scenes)).sum()) for scenes in (plain, linked))
    assert after < 0.8 * before


def test_energy_guidance_depends_on_the_scenes_own_key_only(pointed_model, known):
    condition = Condition(known=known, num_lanes=9, num_agents=6)
    many, one = (sample_guided(pointed_model, condition, EnergyGuidance(gradient_steps=2), number) for number in (2, 1))
    np.testing.assert_allclose(one.agents[0], many.agents[0], atol=5e-3)


def test_energy_guidance_needs_position_heads(model):
    with pytest.raises(ValueError, match="energy_guidance needs a denoiser that estimates positions"):
        sample(model, Condition(**COUNTS), energy_guidance=True)


def test_energy_guidance_is_the_models_by_default(pointed_model, known):
    model, condition = pointed_model, Condition(known=known, num_lanes=9, num_agents=6)
    plain, guided = (sample_guided(model, condition, option) for option in (None, True))
    guiding = dataclasses.replace(model, energy_guidance=EnergyGuidance())
    assert not np.array_equal(plain.lanes, guided.lanes)
    chex.assert_trees_all_equal(sample_guided(guiding, condition, None).to_dict(), guided.to_dict())
    chex.assert_trees_all_equal(sample_guided(guiding, condition, False).to_dict(), plain.to_dict())


def test_sampler_default_fits_the_prediction(model):
    condition = Condition(**COUNTS)
    chex.assert_trees_all_equal(sample(model, condition).to_dict(), sample(model, condition, sampler="ddpm").to_dict())
    flow = tiny_model(prediction="flow")
    validate(sample(flow, condition))
    chex.assert_trees_all_equal(sample(flow, condition).to_dict(), sample(flow, condition, sampler="heun").to_dict())


def test_sampler_that_does_not_fit_is_refused(model):
    with pytest.raises(ValueError, match=r"estimates flow: choose one of dpm\+\+, euler, heun"):
        sample(tiny_model(prediction="flow"), sampler="ddpm")
    with pytest.raises(ValueError, match=r"no sampler 'plms': choose one of ddpm, ddim, dpm\+\+"):
        sample(model, sampler="plms")


def test_temperature_is_the_models_by_default(model):
    condition = Condition(**COUNTS)
    cold = dataclasses.replace(model, temperature=PerType(agents=0.5, lanes=0.5))
    halved = sample(model, condition, temperature=0.5)
    chex.assert_trees_all_equal(sample(cold, condition).to_dict(), halved.to_dict())
    chex.assert_trees_all_equal(
        sample(cold, condition, temperature=model.temperature).to_dict(), sample(model, condition).to_dict()
    )
    assert not np.allclose(halved.agents, sample(model, condition).agents, atol=0.05)


def test_steps_and_guidance_are_the_models_by_default(model):
    quick = dataclasses.replace(model, num_steps=2, guidance=1.0)
    plain = scjax.sample(0, Condition(**COUNTS), model=model, num_steps=2, guidance=1.0)
    chex.assert_trees_all_equal(scjax.sample(0, Condition(**COUNTS), model=quick).to_dict(), plain.to_dict())


def test_a_sampler_that_is_named_takes_its_own_steps(model):
    quick = dataclasses.replace(model, num_steps=2)
    plain = scjax.sample(0, Condition(**COUNTS), model=model, sampler="ddim")
    chex.assert_trees_all_equal(
        scjax.sample(0, Condition(**COUNTS), model=quick, sampler="ddim").to_dict(), plain.to_dict()
    )


def test_temperature_of_zero_is_refused(model):
    with pytest.raises(ValueError, match="temperature must be positive"):
        sample(model, temperature=PerType(agents=1.0, lanes=0.0))


def test_guidance_options_change_the_scene(model):
    condition = Condition(**COUNTS)
    plain, constant = sample(model, condition, guidance=1.0), sample(model, condition, guidance=3.0)
    everywhere = sample(model, condition, guidance=Guidance(3.0, interval=(0.0, 99.0)))
    np.testing.assert_allclose(everywhere.lanes, constant.lanes, atol=2e-3)
    rescaled = sample(model, condition, guidance=Guidance(3.0, rescale=1.0))
    assert not np.allclose(rescaled.lanes, constant.lanes, atol=0.05)
    assert not np.allclose(plain.lanes, constant.lanes, atol=0.05)


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        (Condition(num_lanes=101, num_agents=3), "num_lanes is 101"),
        (Condition(domain="mars"), "mars.*here, there"),
        (Condition(domain=7), "outside 0..1"),
        (Condition(streams={"text": Stream(np.zeros((3, 4), np.float32))}), "unconditional"),
        (Condition(known=unpadded(example_scene(lanes=6)), num_lanes=5), "known elements"),
    ],
)
def test_sample_refuses_what_the_model_cannot_meet(model, condition, message):
    with pytest.raises(ValueError, match=message):
        sample(model, condition)


def test_sample_refuses_a_model_without_a_network(model):
    for name in ("denoiser", "autoencoder"):
        with pytest.raises(ValueError, match=f"no {name}: train that stage"):
            sample(model.without(name))
    with pytest.raises(ValueError, match=r"num_scenes must be a whole number in 1\.\.100000, not 0"):
        sample(model, num_scenes=0)


def test_text_guidance_changes_the_scene():
    model = tiny_model(TextCondition(width=6))
    tokens = np.random.default_rng(0).normal(size=(5, 6)).astype(np.float32)
    text = Condition(streams={"text": Stream(tokens)}, **COUNTS)
    unread, read = (sample(model, [first, text])[0] for first in (Condition(**COUNTS), text))
    assert not np.allclose(unread.lanes, read.lanes)
