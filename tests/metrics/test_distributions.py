"""Properties of the pooled tables (metrics.md §8): identity, symmetry, streaming, order, rigid motion, emptiness."""

import math

import numpy as np
import pytest
from scipy.stats import entropy

from scjax.metrics.distances import frechet, histogram, jensen_shannon, mean_and_deviation, moments
from scjax.metrics.distributions import GRAPH, VEHICLE, add, circles_touch, scene_sums, table
from scjax.metrics.lines import polyline_lengths, resample_polylines
from scjax.scene import AgentType, permute
from scjax.scene.lane_chains import merge_degree2_chains
from tests.factories.traffic import agent, crossing, lane, random_traffic, scene


def test_table_of_equal_sets_is_zero():
    sums = add(scene_sums(random_traffic(seed)) for seed in range(5))
    row = table(sums, sums)
    for name in (*(f"frechet_{name}" for name in GRAPH), *(f"{name}_jsd" for name in VEHICLE)):
        assert row[name] == pytest.approx(0, abs=1e-7), name


@pytest.mark.parametrize("mode", ["compat", "strict"])
def test_table_is_symmetric(mode):
    first, second = (add(scene_sums(random_traffic(seed), mode) for seed in part) for part in (range(6), range(6, 12)))
    there, back = table(first, second), table(second, first)
    for name in there:
        if "frechet" in name or "jsd" in name:
            assert there[name] == pytest.approx(back[name]) and there[name] > 0, name


def test_scene_sums_ignore_order_and_shards():
    scenes = [random_traffic(seed) for seed in range(7)]
    whole = add(map(scene_sums, scenes))
    parts = add([add(map(scene_sums, scenes[4:])), add(map(scene_sums, scenes[:4]))])
    rng = np.random.default_rng(0)
    shuffled = [permute(s, rng.permutation(8), rng.permutation(9)) for s in scenes]
    mixed = add(map(scene_sums, shuffled))
    for name, value in whole.items():
        np.testing.assert_allclose(parts[name], value, rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(mixed[name], value, rtol=1e-9, err_msg=name)


def test_scene_sums_are_invariant_to_rigid_motion():
    original, turn = random_traffic(3), 0.6
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    agents, lanes = original.agents.astype(np.float64), original.lanes.astype(np.float64)
    agents[:, :2] = agents[:, :2] @ rotation.T + [3, -4]
    agents[:, 4:6] = agents[:, 4:6] @ rotation.T
    lanes[..., :2] = lanes[..., :2] @ rotation.T + [3, -4]
    moved = original.replace(agents=agents.astype(np.float32), lanes=lanes.astype(np.float32))
    before, after = scene_sums(original), scene_sums(moved)
    for name in set(before) - {"route_length"}:
        np.testing.assert_allclose(after[name], before[name], rtol=1e-4, atol=1e-4, err_msg=name)


def test_scene_sums_ignore_cuts_of_a_lane():
    whole = scene(
        [agent(1, 1)],
        [lane((-20, 0), (20, 0)), lane((20, 0), (30, 9)), lane((20, 0), (30, -9))],
        joined=[(0, 1), (0, 2)],
    )
    cut = scene(
        [agent(1, 1)],
        [lane((-20, 0), (-3, 0)), lane((-3, 0), (20, 0)), lane((20, 0), (30, 9)), lane((20, 0), (30, -9))],
        joined=[(0, 1), (1, 2), (1, 3)],
    )
    first, second = scene_sums(whole), scene_sums(cut)
    for name in set(first) - {"route_length"}:
        np.testing.assert_allclose(second[name], first[name], atol=1e-4, err_msg=name)
    assert merge_degree2_chains(4, {(0, 1), (1, 2), (1, 3)})[0] == [[0, 1], [2], [3]]


def test_frechet_has_its_closed_form():
    rng = np.random.default_rng(0)
    values = rng.normal(2, 3, 500)
    assert frechet(moments(values), moments(values + 1.5)) == pytest.approx(1.5)
    assert frechet(moments(values), moments(2 * values)) == pytest.approx(np.hypot(values.mean(), values.std(ddof=1)))
    mean, deviation = mean_and_deviation(moments(values))
    assert (mean, deviation) == (pytest.approx(values.mean()), pytest.approx(values.std(ddof=1)))


def test_jensen_shannon_is_divergence_to_the_mixture():
    first, second = np.array([3.0, 1, 0]), np.array([0.0, 2, 2])
    p, q = first / 4, second / 4
    want = (entropy(p, (p + q) / 2) + entropy(q, (p + q) / 2)) / 2
    assert jensen_shannon(first, second) == pytest.approx(want)
    assert jensen_shannon(np.array([5.0, 0]), np.array([0.0, 9])) == pytest.approx(math.log(2))


def test_histogram_closes_its_last_bin():
    quantity = VEHICLE["lat_dev"]
    assert len(histogram(np.zeros(0), *quantity[:3])) == 15
    np.testing.assert_array_equal(np.flatnonzero(histogram(np.array([1.5, 7.0]), *quantity[:3])), [14])
    assert len(histogram(np.zeros(0), *VEHICLE["length"][:3])) == 250
    rng = np.random.default_rng(0)
    for low, high, width, _ in VEHICLE.values():
        edges = np.arange(low, high + width, width)
        values = np.concatenate([rng.uniform(low - 1, high + 1, 500), edges, np.array([low, high])])
        expected = np.histogram(np.clip(values, low, high), edges)[0]
        np.testing.assert_array_equal(histogram(values, low, high, width), expected)


def test_table_is_nan_for_empty_sides():
    bare = scene_sums(scene())
    assert bare["scenes_without_lanes"] == bare["scenes_without_vehicles"] == bare["scenes"] == 1
    row = table(bare, add([bare, scene_sums(random_traffic(0))]))
    assert all(math.isnan(value) for value in row.values())
    one = scene_sums(crossing())
    both = add([bare, one])
    for name in one:
        if not name.startswith("scenes"):
            np.testing.assert_array_equal(both[name], one[name], err_msg=name)


def test_scene_sums_skip_pedestrians_and_unknown_values():
    cars = scene_sums(scene([agent(0, 0), agent(9, 0)], [lane((-9, 0), (9, 0))]))
    walker = scene_sums(
        scene(
            [agent(0, 0), agent(9, 0), agent(1, 1)],
            [lane((-9, 0), (9, 0))],
            types=[AgentType.VEHICLE, AgentType.VEHICLE, AgentType.PEDESTRIAN],
        )
    )
    for name, value in cars.items():
        np.testing.assert_array_equal(walker[name], value, err_msg=name)
    original = scene([agent(0, 0), agent(9, 0)], [lane((-9, 0), (9, 0))])
    original.agent_known[1, 6] = False
    assert scene_sums(original)["length"].sum() == 1 and scene_sums(original)["speed"].sum() == 2


def test_circles_touch_is_wider_than_boxes():
    abreast = np.stack([agent(0, 0), agent(0, 2.04)]).astype(np.float64)
    assert circles_touch(abreast).any()
    abreast[:, 7] -= 0.1
    assert not circles_touch(abreast).any()
    assert not circles_touch(abreast[:1]).any()


def test_resample_polylines_equals_interpolation():
    rng = np.random.default_rng(0)
    lines = np.cumsum(rng.normal(1, 1, (5, 20, 2)), 1)
    dense = resample_polylines(lines, 100)
    for line, points in zip(lines, dense, strict=True):
        step = np.sqrt(np.square(np.diff(line, axis=0)).sum(-1))
        arc = np.concatenate([[0], np.cumsum(step)])
        at = np.linspace(0, arc[-1], 100)
        want = np.stack([np.interp(at, arc, line[:, k]) for k in (0, 1)], -1)
        np.testing.assert_array_equal(points, want)
    np.testing.assert_allclose(
        polyline_lengths(lines), [np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for x in lines]
    )
