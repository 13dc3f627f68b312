"""Known elements of training scenes: which, in which order, and that nothing else changes."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from scjax.scene import Crop
from scjax.scene.partition import elements_behind
from scjax.train.objectives.known_elements import KnownShares, draw_known
from tests.factories.examples import example_batch

SCENES = 6
_known_of = jax.jit(draw_known, static_argnums=3)


def _batch(crop):
    return example_batch(SCENES, agents=7, lanes=9, crop=crop)


def _draw(crop, lanes=0.0, region=0.0):
    batch = _batch(crop)
    keys = jax.random.split(jax.random.key(1), SCENES)
    return batch, *_known_of(keys, batch, elements_behind(batch), KnownShares(lanes=lanes, region=region))


@pytest.mark.parametrize("shares", [{}, {"lanes": 1.0}, {"region": 1.0}])
@pytest.mark.parametrize("crop", [Crop.CENTERED, Crop.PARTITIONED])
def test_known_tokens_come_first_and_scenes_stay_what_they_are(crop, shares):
    before, after, known, apart = _draw(crop, **shares)
    for flags, mask in ((known.agents, after.agent_mask), (known.lanes, after.lane_mask)):
        assert (np.diff(np.asarray(flags).astype(int), axis=1) <= 0).all() and not (flags & ~mask).any()
    for flags, other in ((apart.agents, known.agents), (apart.lanes, known.lanes)):
        assert not (flags & ~other).any()
    for row in range(SCENES):
        old, new = (np.asarray(scene.lanes[row]) for scene in (before, after))
        order = [int(np.abs(old - lane).max((1, 2)).argmin()) for lane in new]
        assert np.array_equal(new, old[order])
        assert np.array_equal(after.links[row], np.asarray(before.links[row])[np.ix_(order, order)])
        assert np.array_equal(np.sort(after.agents[row], 0), np.sort(before.agents[row], 0))


def test_all_lanes_are_known_and_in_some_scenes_agents():
    _, after, known, apart = _draw(Crop.CENTERED, lanes=1.0)
    assert np.array_equal(known.lanes, after.lane_mask) and not apart.lanes.any()
    counts = np.asarray(known.agents).sum(1)
    assert (counts == 0).any() and (counts > 0).any()


def test_regions_are_known_in_part_and_hold_the_ego():
    before, after, known, apart = _draw(Crop.CENTERED, region=1.0)
    assert np.array_equal(known.lanes, apart.lanes) and np.array_equal(known.agents, apart.agents)
    assert 0 < np.asarray(known.lanes).sum() < np.asarray(after.lane_mask).sum()
    assert np.array_equal(after.agents[:, 0], before.agents[:, 0]) and known.agents[:, 0].all()


def test_without_shares_only_the_rear_half_of_partitioned_scenes_is_known():
    assert not _draw(Crop.CENTERED)[2].lanes.any()
    _, after, known, _ = _draw(Crop.PARTITIONED)
    middle = after.lanes.shape[-2] // 2 - 1
    assert np.array_equal(known.lanes, (after.lanes[..., middle, 0] <= 0) & after.lane_mask)
