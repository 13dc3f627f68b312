"""Points are read off latents: here off latents that are the points, mixed and bent."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np

from scjax.data.loader import TrainingExample, batch_of
from scjax.models.denoiser.position_head import AHEAD, UNIT, PositionHead
from scjax.nn.functional import functional
from scjax.scene import Crop, unpadded
from scjax.scene.per_type import PerType
from scjax.train.fit_position_head import FitOptions, fit_position_heads, position_targets
from tests.factories.examples import example_scene

SIZES = {"agents": (4, 2), "lanes": (10, 5)}  # latent numbers and points


@functools.cache
def _batch(seed):
    """Twelve scenes; both fits read the same 40 batches."""
    crops = list(Crop)
    scenes = [unpadded(example_scene(seed + k, crop=crops[k % 3]).to_numpy()) for k in range(12)]
    return batch_of([TrainingExample(scene=scene) for scene in scenes], (6, 8))


def test_position_targets_are_relative_to_the_window_center():
    scene = _batch(0).scene
    found = position_targets(scene)
    for kind, mask in (("agents", scene.agent_mask), ("lanes", scene.lane_mask)):
        assert np.abs(found[kind][mask][:, 0]).max() * UNIT < 32
    ahead = UNIT * (found["agents"][:, :, 1] - found["agents"][:, :, 0])
    np.testing.assert_allclose(ahead, AHEAD * scene.agents[..., 4:6], atol=1e-4)
    along = UNIT * (found["lanes"][:, :, -1] - found["lanes"][:, :, 0])
    np.testing.assert_allclose(along, scene.lanes[:, :, -1, :2] - scene.lanes[:, :, 0, :2], atol=1e-4)


def _fit_error(spoilt=0.0):
    """Median error [m] per type on unseen scenes, whose latents are bent points; a share of the fit's is noise."""
    rng = np.random.default_rng(0)
    mixing = {"agents": np.linalg.qr(rng.normal(size=(4, 4)))[0], "lanes": np.linalg.qr(rng.normal(size=(10, 10)))[0]}

    def latents_of(scene, spoilt=spoilt):
        points = jax.tree.map(lambda x: x.reshape(*x.shape[:2], -1), position_targets(scene))
        bent = {kind: np.sinh(points[kind] / 2) @ mixing[kind] for kind in points}
        noise = {
            kind: np.where(rng.random((*x.shape[:2], 1)) < spoilt, rng.normal(size=x.shape), x)
            for kind, x in bent.items()
        }
        return PerType(**{kind: value.astype(np.float32) for kind, value in noise.items()})

    batches, options = (_batch(12 * k) for k in itertools.count()), FitOptions(batches=40, steps=400)
    heads = fit_position_heads(batches, latents_of, jax.random.key(0), options)
    unseen, errors = _batch(10_000).scene, {}
    latents, targets = latents_of(unseen, 0.0), position_targets(unseen)
    for kind, mask in (("agents", unseen.agent_mask), ("lanes", unseen.lane_mask)):
        network = functional(lambda init, kind=kind: PositionHead(*SIZES[kind], init=init))
        read = network.apply(heads[kind], jnp.asarray(getattr(latents, kind)))
        errors[kind] = np.median(np.linalg.norm(read - targets[kind], axis=-1)[mask]) * UNIT
    return errors


def test_fit_position_heads_reads_points_off_latents(capsys):
    errors = _fit_error()
    assert "median" in capsys.readouterr().out
    assert max(errors.values()) < 0.5


def test_few_useless_latents_hardly_change_the_fit():
    assert max(_fit_error(spoilt=0.1).values()) < 1.0
