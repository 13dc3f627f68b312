"""Sampling and reconstruction with ``AutoencoderConfig.shared_endpoints``: linked ends meet, known lanes stay."""

from __future__ import annotations

import dataclasses

import numpy as np

import scjax
from scjax.generate.reconstruct import reconstruct
from scjax.metrics.realism import connection_gaps
from scjax.scene import Link, Scene
from tests.factories.repair_scenes import chain
from tests.factories.worlds import AUTOENCODER, tiny_model


def model(shared_endpoints: bool):
    base = tiny_model()
    config = dataclasses.replace(AUTOENCODER, shared_endpoints=shared_endpoints)
    return base.with_component("autoencoder", config, base.autoencoder.params)


def sample(shared_endpoints: bool, num_lanes: int, **condition) -> Scene:
    """Eight scenes."""
    condition = scjax.Condition(num_agents=3, num_lanes=num_lanes, **condition)
    return scjax.sample(0, condition, num_scenes=8, model=model(shared_endpoints), num_steps=2, padded_size=(8, 8))


def test_linked_ends_of_samples_meet():
    """Between two lanes no link has to go but the wide ones."""
    plain, closed = sample(False, 2), sample(True, 2)
    assert connection_gaps(plain[0]).max() > 0.1
    assert not any(connection_gaps(closed[i]).any() for i in range(8))
    assert (closed.links == Link.PREDECESSOR).any()


def test_known_lanes_stay_and_new_ones_end_there():
    known = chain(0.0, lanes=2)
    scene = sample(True, 6, known=known)[0]
    np.testing.assert_array_equal(scene.lanes[:2], known.lanes)
    pairs = np.argwhere((np.asarray(scene.links) == Link.PREDECESSOR) & ~np.eye(6, dtype=bool))
    for before, after in pairs:
        if (before < 2) != (after < 2):
            np.testing.assert_allclose(scene.lanes[before, -1], scene.lanes[after, 0], atol=1e-5)


def test_reconstruction_meets_too():
    scene = chain(0.0, lanes=2)
    ((plain,), (decoded,)) = (reconstruct(model(flag), [scene]) for flag in (False, True))
    assert connection_gaps(plain).max() > 0.1 and not connection_gaps(decoded).any()
