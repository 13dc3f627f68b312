"""Properties of the pooled tables (metrics.md §8): identity, symmetry, streaming, order, rigid motion, emptiness."""

import math

import numpy as np
import pytest
from scipy.stats import entropy

from scjax.metrics.distances import frechet, histogram, jensen_shannon, mean_and_deviation, moments
from scjax.metrics.distributions import GRAPH, VEHICLE, add, circles_touch, scene_sums, table
from scjax.metrics.lines import lengths, resampled
from scjax.scene import AgentType, permute
from scjax.scene.lane_chains import compact
from tests.factories.traffic import agent, crossing, lane, scene


def traffic(seed, cars=8, lanes=9):
    """A scene of lanes and cars at random."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-30, 30, (lanes, 2, 2))
    joined = {(int(i), int(j)) for i, j in rng.integers(lanes, size=(lanes, 2)) if i < j}
    sizes = rng.uniform((3.5, 1.6, 1.4), (7, 2.6, 3), (cars, 3))
    boxes = [agent(*rng.uniform(-25, 25, 2), rng.uniform(-180, 180), rng.uniform(0, 15), size) for size in sizes]
    return scene(boxes, [lane(tuple(a), tuple(b)) for a, b in ends], joined=sorted(joined))


def test_equal_sets_are_at_distance_zero():
    sums = add(scene_sums(traffic(seed)) for seed in range(5))
    row = table(sums, sums)
    for name in (*(f"frechet_{name}" for name in GRAPH), *(f"{name}_jsd" for name in VEHICLE)):
        assert row[name] == pytest.approx(0, abs=1e-7), name


@pytest.mark.parametrize("mode", ["compat", "strict"])
def test_swapping_the_sides_keeps_distances(mode):
    first, second = (add(scene_sums(traffic(seed), mode) for seed in part) for part in (range(6), range(6, 12)))
    there, back = table(first, second), table(second, first)
    for name in there:
        if "frechet" in name or "jsd" in name:
            assert there[name] == pytest.approx(back[name]) and there[name] > 0, name


def test_order_batches_and_shards_do_not_matter():
    scenes = [traffic(seed) for seed in range(7)]
    whole = add(map(scene_sums, scenes))
    parts = add([add(map(scene_sums, scenes[4:])), add(map(scene_sums, scenes[:4]))])
    rng = np.random.default_rng(0)
    shuffled = [permute(s, rng.permutation(8), rng.permutation(9)) for s in scenes]
    mixed = add(map(scene_sums, shuffled))
    for name, value in whole.items():
        np.testing.assert_allclose(parts[name], value, rtol=1e-12, err_msg=name)
        np.testing.assert_allclose(mixed[name], value, rtol=1e-9, err_msg=name)


def test_moving_a_scene_changes_only_the_route():
    made, turn = traffic(3), 0.6
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    agents, lanes = made.agents.astype(np.float64), made.lanes.astype(np.float64)
    agents[:, :2] = agents[:, :2] @ rotation.T + [3, -4]
    agents[:, 4:6] = agents[:, 4:6] @ rotation.T
    lanes[..., :2] = lanes[..., :2] @ rotation.T + [3, -4]
    moved = made.replace(agents=agents.astype(np.float32), lanes=lanes.astype(np.float32))
    before, after = scene_sums(made), scene_sums(moved)
    for name in set(before) - {"route_length"}:
        np.testing.assert_allclose(after[name], before[name], rtol=1e-4, atol=1e-4, err_msg=name)


def test_cutting_a_lane_in_two_changes_nothing():
    whole = scene([agent(1, 1)], [lane((-20, 0), (20, 0)), lane((20, 0), (30, 9)), lane((20, 0), (30, -9))],
                  joined=[(0, 1), (0, 2)])  # fmt: skip
    cut = scene([agent(1, 1)], [lane((-20, 0), (-3, 0)), lane((-3, 0), (20, 0)), lane((20, 0), (30, 9)),
                                lane((20, 0), (30, -9))], joined=[(0, 1), (1, 2), (1, 3)])  # fmt: skip
    first, second = scene_sums(whole), scene_sums(cut)
    for name in set(first) - {"route_length"}:
        np.testing.assert_allclose(second[name], first[name], atol=1e-4, err_msg=name)
    assert compact(4, {(0, 1), (1, 2), (1, 3)})[0] == [[0, 1], [2], [3]]


def test_frechet_has_its_closed_form():
    rng = np.random.default_rng(0)
    values = rng.normal(2, 3, 500)
    assert frechet(moments(values), moments(values + 1.5)) == pytest.approx(1.5)
    assert frechet(moments(values), moments(2 * values)) == pytest.approx(np.hypot(values.mean(), values.std(ddof=1)))
    mean, deviation = mean_and_deviation(moments(values))
    assert (mean, deviation) == (pytest.approx(values.mean()), pytest.approx(values.std(ddof=1)))


def test_divergence_is_that_of_the_mixture():
    first, second = np.array([3.0, 1, 0]), np.array([0.0, 2, 2])
    p, q = first / 4, second / 4
    want = (entropy(p, (p + q) / 2) + entropy(q, (p + q) / 2)) / 2
    assert jensen_shannon(first, second) == pytest.approx(want)
    assert jensen_shannon(np.array([5.0, 0]), np.array([0.0, 9])) == pytest.approx(math.log(2))


def test_bins_close_at_the_top():
    quantity = VEHICLE["lat_dev"]
    assert len(histogram(np.zeros(0), *quantity[:3])) == 15
    np.testing.assert_array_equal(np.flatnonzero(histogram(np.array([1.5, 7.0]), *quantity[:3])), [14])
    assert len(histogram(np.zeros(0), *VEHICLE["length"][:3])) == 250
    rng = np.random.default_rng(0)
    for low, high, width, _ in VEHICLE.values():
        edges = np.arange(low, high + width, width)
        values = np.concatenate([rng.uniform(low - 1, high + 1, 500), edges, np.array([low, high])])
        wanted = np.histogram(np.clip(values, low, high), edges)[0]
        np.testing.assert_array_equal(histogram(values, low, high, width), wanted)


def test_nothing_to_compare_is_nan_and_counted():
    bare = scene_sums(scene())
    assert bare["scenes_without_lanes"] == bare["scenes_without_vehicles"] == bare["scenes"] == 1
    row = table(bare, add([bare, scene_sums(traffic(0))]))
    assert all(math.isnan(value) for value in row.values())
    one = scene_sums(crossing())
    both = add([bare, one])
    for name in one:
        if not name.startswith("scenes"):
            np.testing.assert_array_equal(both[name], one[name], err_msg=name)


def test_pedestrians_and_unknown_values_take_no_part():
    cars = scene_sums(scene([agent(0, 0), agent(9, 0)], [lane((-9, 0), (9, 0))]))
    walker = scene_sums(scene([agent(0, 0), agent(9, 0), agent(1, 1)], [lane((-9, 0), (9, 0))],
                              types=[AgentType.VEHICLE, AgentType.VEHICLE, AgentType.PEDESTRIAN]))  # fmt: skip
    for name, value in cars.items():
        np.testing.assert_array_equal(walker[name], value, err_msg=name)
    made = scene([agent(0, 0), agent(9, 0)], [lane((-9, 0), (9, 0))])
    made.agent_known[1, 6] = False
    assert scene_sums(made)["length"].sum() == 1 and scene_sums(made)["speed"].sum() == 2


def test_circles_are_fatter_than_the_boxes_they_stand_for():
    abreast = np.stack([agent(0, 0), agent(0, 2.04)]).astype(np.float64)
    assert circles_touch(abreast).any()
    abreast[:, 7] -= 0.1
    assert not circles_touch(abreast).any()
    assert not circles_touch(abreast[:1]).any()


def test_resampling_is_interpolation_over_the_arc():
    rng = np.random.default_rng(0)
    lines = np.cumsum(rng.normal(1, 1, (5, 20, 2)), 1)
    dense = resampled(lines, 100)
    for line, points in zip(lines, dense, strict=True):
        step = np.sqrt(np.square(np.diff(line, axis=0)).sum(-1))
        arc = np.concatenate([[0], np.cumsum(step)])
        at = np.linspace(0, arc[-1], 100)
        want = np.stack([np.interp(at, arc, line[:, k]) for k in (0, 1)], -1)
        np.testing.assert_array_equal(points, want)
    np.testing.assert_allclose(lengths(lines), [np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for x in lines])
