"""Control metrics: what a copy, chance and growing corruption score; shuffles and pairs across clusters."""

import json
import math

import numpy as np
import pytest

from scjax.evaluate.corruption import LADDER, mix_scenes
from scjax.metrics.control import ControlFrame, ccs, csc, derangements, scene_pairs, spg
from scjax.metrics.descriptors import LEVELS, Standard, describe
from scjax.scene import pad, permute
from tests.factories.traffic import agent, crossing, eval_table, eval_tiles, scene


@pytest.fixture(scope="module")
def tiles(eval_dir):
    """A fifth of the shared tiles, their clusters, and their standardised descriptors."""
    rows = list(range(0, 1239, 5))
    scenes = eval_tiles(eval_dir, "train", only=rows)
    raw = describe(scenes)
    return scenes, list(eval_table(eval_dir, "train")["tile_cluster"][rows]), Standard.of(raw)


def scores(unit, reference, sample, clusters, seed=0):
    rng = np.random.default_rng(seed)
    shuffles, pairs = derangements(clusters, rng), scene_pairs(clusters, rng)
    ours, theirs = unit(describe(sample)), unit(describe(reference))
    return {
        level: (ccs(x, y), spg(x, y, shuffles), csc(x, y, pairs))
        for level in LEVELS
        for x, y in [(getattr(theirs, level), getattr(ours, level))]
    }


def test_control_orders_the_corruption_ladder(tiles):
    scenes, clusters, unit = tiles
    rng = np.random.default_rng(1)
    size = np.array([[len(s.lanes), len(s.agents)] for s in scenes])
    label = np.unique(np.array([str(c) for c in clusters]), return_inverse=True)[1]
    gap = np.abs(size[:, None] - size[None]).sum(-1) + 1000 * (label[:, None] == label[None])
    others = [scenes[int(rng.choice(np.argsort(row)[:5]))] for row in gap]
    ladder = [
        [mix_scenes(s, o, *shares, rng) for s, o in zip(scenes, others, strict=True)]
        for shares in ((0.0, 0.0), *LADDER.values())
    ]
    steps = [
        scores(unit, scenes, crossing_scene, clusters) for crossing_scene in [*ladder, scenes]
    ]  # U < C1 < C2 < C3 < copy
    for level in LEVELS:
        for k, name in enumerate(("CCS", "SPG", "CSC")):
            climb = [step[level][k] for step in steps]
            assert climb == sorted(climb) and len(set(climb)) == 5, (level, name, climb)


def test_control_is_full_for_a_copy_and_none_for_chance(tiles):
    scenes, clusters, unit = tiles
    for level, (own, gain, agreement) in scores(unit, scenes, scenes, clusters).items():
        assert own == pytest.approx(1) and agreement == pytest.approx(1), level
        assert gain == pytest.approx(0.024 if level == "glob" else 1, abs=0.05)
    chance = [scenes[i] for i in np.random.default_rng(2).permutation(len(scenes))]
    for level, (_, gain, agreement) in scores(unit, scenes, chance, clusters).items():
        assert abs(gain) < 0.12 and abs(agreement) < 0.1, level


def test_control_intervals_resample_locations(tiles):
    scenes, clusters, _ = tiles
    frame = ControlFrame.of(describe(scenes), clusters, np.random.default_rng(0), pairs=5_000)
    assert all(
        low == pytest.approx(1) == high
        for name, (low, high) in frame.intervals(describe(scenes), clusters, draws=20).items()
        if name.endswith(("CCS", "CSC"))
    )
    raw = describe([scenes[i] for i in np.random.default_rng(2).permutation(len(scenes))])
    values, bounds = frame(raw), frame.intervals(raw, clusters, draws=40)
    assert set(values) == set(bounds)
    for name, value in values.items():
        low, high = bounds[name]
        assert low < high and low - 0.5 * (high - low) < value < high + 0.5 * (high - low), name
    samples, of_copy = (frame.bootstrap_samples(x, clusters, draws=5) for x in (raw, describe(scenes)))
    assert samples.keys() == bounds.keys() and all((samples[name] < of_copy[name]).all() for name in samples)
    wide = frame.intervals(raw, [k % 3 for k in range(len(scenes))], draws=40)["agent CCS"]
    assert wide != bounds["agent CCS"]  # three locations are drawn, not many
    assert np.isnan(frame.intervals(raw, ["one"] * len(scenes), draws=3)["lane CCS"]).all()


def test_descriptors_ignore_order_and_padding():
    crossing_scene = crossing()
    first = describe(crossing_scene)
    permuted = describe(pad(permute(crossing_scene, np.array([0, 3, 2, 1]), np.array([2, 0, 1])), 9, 9))
    for level in LEVELS:
        np.testing.assert_allclose(getattr(first, level), getattr(permuted, level), atol=1e-6)


def test_descriptors_leave_the_ego_out():
    alone = describe(scene([agent(0, 0, 0, 5)]))
    assert not alone.agent.any() and describe(scene([agent(0, 0, 0, 5)]), ego=False).agent.any()
    assert not describe(scene()).lane.any() and np.isfinite(describe(scene()).glob).all()


def test_derangements_leave_every_cluster():
    clusters = list("aaaabbbccdefg")
    for row in derangements(clusters, np.random.default_rng(0), 50):
        assert sorted(row) == list(range(len(clusters)))
        assert all(clusters[i] != clusters[j] for i, j in enumerate(row))
    with pytest.raises(ValueError, match="3 of 4 scenes share a location cluster"):
        derangements(list("aaab"), np.random.default_rng(0))


def test_derangements_reach_every_other_scene():
    clusters = [str(k) for k in range(6)]
    drawn = derangements(clusters, np.random.default_rng(0), 3000)
    for i in range(6):
        share = np.bincount(drawn[:, i], minlength=6) / 3000
        assert share[i] == 0 and np.abs(np.delete(share, i) - 0.2).max() < 0.05


def test_scene_pairs_cross_clusters_and_are_bounded():
    clusters = [str(k // 3) for k in range(300)]
    pairs = scene_pairs(clusters, np.random.default_rng(0))
    assert len(pairs) == 300 * 299 // 2 - 300 and (pairs[:, 0] < pairs[:, 1]).all()
    few = scene_pairs([str(k // 3) for k in range(3000)], np.random.default_rng(0), most=5000)
    assert len(few) == 5000 and (few[:, 0] // 3 != few[:, 1] // 3).all() and len(np.unique(few, axis=0)) == 5000


def test_control_handles_scaled_constant_and_empty_sets():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(30, 5))
    pairs = scene_pairs([str(k) for k in range(30)], rng)
    assert csc(x, 7 * x, pairs) == pytest.approx(1)
    assert math.isnan(csc(x, np.ones_like(x), pairs)) and math.isnan(ccs(x[:0], x[:0]))
    with pytest.raises(ValueError, match="reference set"):
        Standard.of(describe([]))
    assert json.dumps([ccs(x, x), spg(x, x, np.array([np.roll(np.arange(30), 1)]))])
