"""One network for requests, pictures, both and none."""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import scjax
from scjax.diffusion.denoise_fn import prepare_denoiser_inputs
from scjax.generate.conditions import Condition
from scjax.generate.encode import network_inputs
from scjax.generate.readings import PromptReadings
from scjax.language.attributes.vector import request_vector
from scjax.models.denoiser.model import denoiser
from scjax.scene import Crop
from scjax.scene.per_type import PerType
from tests.factories.pictures import GRID, feature_streams, picture_model, without_pictures

AHEAD = {"num_lanes": 5, "num_agents": 4, "domain": 0, "crop": Crop.FORWARD}
REQUEST = {"layout": "T", "vehicles": 3}
NO_CELLS = np.zeros(GRID[0] * GRID[1], bool)


def condition(*, request=None, streams=None):
    return Condition(attributes=request or {}, streams=streams or {}, **AHEAD)


NOTHING, REQUESTED = condition(), condition(request=REQUEST)
SEEN, OTHER = condition(streams=feature_streams(0)), condition(streams=feature_streams(1))
BOTH = condition(request=REQUEST, streams=feature_streams(0))


@pytest.fixture(scope="module")
def model():
    return picture_model()


@pytest.fixture
def sample(model):
    """Always two scenes at once, which is one program; the first is returned."""

    def run(first, second=None, model=model, **options):
        options = {"num_steps": 3, "guidance": 1.0, **options}
        return scjax.sample(jax.random.key(0), [first, second or first], model=model, **options)[0]

    return run


def assert_differ(*scenes):
    lanes = [scene.lanes for scene in scenes]
    assert not any(np.allclose(lanes[i], lanes[j], atol=1e-3) for i in range(len(lanes)) for j in range(i))


def test_request_picture_and_both_change_the_scene(sample):
    assert_differ(sample(NOTHING), sample(REQUESTED), sample(SEEN), sample(OTHER), sample(BOTH))


@pytest.mark.parametrize("attributes", [{}, REQUEST])
def test_network_without_a_picture_is_the_one_that_reads_none(model, attributes):
    """Bit for bit: an absent picture, one without cells, no cache at all, and a network without cross attention."""
    config, params = model.denoiser.config, jax.tree.map(jnp.asarray, model.denoiser.params)
    rng = np.random.default_rng(0)
    z = PerType(
        agents=rng.normal(size=(2, 4, config.agent_latent)).astype(np.float32),
        lanes=rng.normal(size=(2, 5, config.lane_latent)).astype(np.float32),
    )
    masks = PerType(agents=jnp.ones((2, 4), bool), lanes=jnp.ones((2, 5), bool))
    requested = jnp.asarray(request_vector(attributes, config.attributes))[None].repeat(2, 0)
    arguments = (z, jnp.array([50, 50]), jnp.array([2, 2]), masks)

    def estimate(streams):
        cache = None
        if streams is not None:
            features, _ = network_inputs([streams, feature_streams(3)], config.condition)
            cache = denoiser(config).apply(params, features, jnp.zeros(2, bool), method="encode_condition")
        out = denoiser(config).apply(params, *arguments, cache=cache, attributes=requested)
        return jax.tree.map(lambda x: x[:1], out)

    plain = without_pictures(model).denoiser
    expected = denoiser(plain.config).apply(jax.tree.map(jnp.asarray, plain.params), *arguments, attributes=requested)
    expected = jax.tree.map(lambda x: x[:1], expected)
    chex.assert_trees_all_equal(expected, estimate(None), estimate({}), estimate(feature_streams(1, NO_CELLS)))
    assert not np.allclose(expected.lanes, estimate(feature_streams(1)).lanes)


def test_scenes_without_a_picture_are_those_of_a_network_that_reads_none(model, sample, guidance=2.0):
    """Guided, which evaluates both branches."""
    plain = without_pictures(model)
    for one in (NOTHING, REQUESTED):
        expected = sample(one, model=plain, guidance=guidance)
        unseen = condition(request=one.attributes, streams=feature_streams(1, NO_CELLS))
        chex.assert_trees_all_close(expected.to_dict(), sample(one, guidance=guidance).to_dict(), atol=2e-3)
        chex.assert_trees_all_close(expected.to_dict(), sample(unseen, guidance=guidance).to_dict(), atol=2e-3)


def test_guidance_leads_away_from_neither_picture_nor_request(sample):
    """At scale 0 what remains is the estimate without both; above 1 both are followed more closely."""
    scenes = [sample(one, guidance=0.0) for one in (NOTHING, REQUESTED, SEEN, BOTH)]
    chex.assert_trees_all_close(*[scene.to_dict() for scene in scenes], atol=2e-3)
    guided = [sample(one, guidance=3.0) for one in (REQUESTED, SEEN, BOTH)]
    assert_differ(scenes[0], *guided)
    assert all(np.isfinite(scene.lanes).all() for scene in guided)


def test_request_and_picture_are_guided_apart(sample):
    """Without weight the picture has no effect, and equal scales are one scale."""
    alone = sample(REQUESTED, guidance=2.0)
    unseen = sample(BOTH, guidance=scjax.Guidance(2.0, image_scale=0.0))
    chex.assert_trees_all_close(alone.to_dict(), unseen.to_dict(), atol=2e-3)
    both, equal = (sample(BOTH, guidance=guidance) for guidance in (2.0, scjax.Guidance(2.0, image_scale=2.0)))
    chex.assert_trees_all_close(both.to_dict(), equal.to_dict(), atol=2e-3)
    assert_differ(alone, both, sample(BOTH, guidance=scjax.Guidance(2.0, image_scale=1.0)))
    plain, ones = sample(BOTH), sample(BOTH, guidance=scjax.Guidance(1.0, image_scale=1.0))
    chex.assert_trees_all_equal(plain.to_dict(), ones.to_dict())


def test_scale_of_a_picture_needs_a_model_that_reads_some(model):
    with pytest.raises(ValueError, match=r"guidance\.image_scale is given, but this model reads no pictures"):
        scjax.sample(0, NOTHING, model=without_pictures(model), guidance=scjax.Guidance(2.0, image_scale=1.0))


def test_unconditional_branch_has_neither_picture_nor_request(model):
    config = model.denoiser.config
    features, _ = network_inputs([feature_streams(0)], config.condition)

    @jax.jit
    def prepare(params):
        return prepare_denoiser_inputs(
            denoiser(config),
            config,
            params,
            jnp.array([2]),
            PerType(agents=jnp.ones((1, 4), bool), lanes=jnp.ones((1, 5), bool)),
            times=np.array([10.0, 50.0], np.float32),
            guided=True,
            attributes=jnp.asarray(request_vector(REQUEST, config.attributes))[None],
            features=features,
        )

    inputs = prepare(model.denoiser.params)
    assert inputs.conditional.cache is not None and inputs.conditional.attributes.any()
    assert inputs.unconditional.cache is None and not inputs.unconditional.attributes.any()


@pytest.mark.parametrize("guidance", [1.0, 2.5])
def test_scenes_do_not_depend_on_the_conditions_beside_them(sample, guidance):
    for one in (NOTHING, REQUESTED, SEEN, BOTH):
        alone = sample(one, guidance=guidance)
        for other in (NOTHING, OTHER, BOTH):
            among = sample(one, other, guidance=guidance)
            chex.assert_trees_all_close(alone.to_dict(), among.to_dict(), atol=2e-3)


def test_prompt_and_picture_go_into_one_condition(model, sample, monkeypatch):
    """A prompt with a picture is the request that the reader makes of it, with that picture."""
    monkeypatch.setattr(
        "scjax.generate.scene_spec.read_prompts",
        lambda conditions, model: PromptReadings(
            [condition(request=REQUEST, streams=one.streams) if one.prompt else one for one in conditions],
            [[] for _ in conditions],
            [{} for _ in conditions],
        ),
    )
    prompted = Condition(prompt="a T-junction with three vehicles", streams=feature_streams(0), **AHEAD)
    chex.assert_trees_all_equal(sample(prompted).to_dict(), sample(BOTH).to_dict())
