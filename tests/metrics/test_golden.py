"""Every entry of every golden_metrics*.json in the evaluation folder, to its tolerance of 1e-6."""

import functools
import json
import math

import numpy as np
import pytest

from scjax.metrics.control import ccs, csc, scene_pairs, spg
from scjax.metrics.descriptors import LEVELS, Descriptor, Standard, describe
from scjax.metrics.detection import average_precision, detections
from scjax.metrics.distributions import add, scene_sums, table
from scjax.metrics.placement import match, match_summary
from scjax.metrics.pooling import pool
from scjax.metrics.topology import compact_lanes, degrees, endpoint_gaps, key_points, reach_and_hops, route_length
from scjax.scene import AgentType
from scjax.scene.boxes import intersection_areas, overlaps
from tests.factories.traffic import eval_table, eval_tiles

TOLERANCE = 1e-6


class Golden:
    """All golden files, and the tiles that they name, read once."""

    def __init__(self, folder):
        self._folder = folder
        self.files = {path.name: json.loads(path.read_text()) for path in sorted(folder.glob("golden_metrics*.json"))}
        if not self.files:
            pytest.skip(f"there is no golden_metrics*.json in {folder}")
        self.tiles = functools.cache(lambda name, agents: eval_tiles(folder, name, variant=agents))
        self.sums = functools.cache(lambda name, agents, tile: scene_sums(self.tiles(name, agents)[tile], "compat"))

    def entries(self, *path):
        """(file, entry) of a list inside every file; a file may lack it."""
        for name, content in self.files.items():
            for key in path:
                content = content.get(key, {})
            yield from ((f"{name}: {entry.get('name', entry)}", entry) for entry in content)

    def scenes(self, side):
        tiles = self.tiles(side["set"], side.get("agents", "main"))
        return [tiles[tile] for tile in side["tiles"]]

    def clusters(self, side):
        return eval_table(self._folder, side["set"])["tile_cluster"][side["tiles"]]


@pytest.fixture(scope="module")
def golden(eval_dir):
    return Golden(eval_dir)


def has_ego(name):
    return name != "peer"  # tiles along a route, not around a vehicle


def close(ours, theirs, where, *, rounding=0.0):
    theirs = math.nan if theirs is None else theirs
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=TOLERANCE + rounding, err_msg=where)


def rank_rounding(reference, generated, pairs, draws=32):
    """How far the last bit of the descriptors moves a rank correlation: scenes that occur twice make distances that are
    equal but for rounding, and the golden ranks hold the order that one processor's matrix product gave them."""
    rng = np.random.default_rng(0)

    def nudged(vectors):
        return vectors * (1 + 1e-15 * rng.normal(size=vectors.shape))

    result = [csc(nudged(reference), nudged(generated), pairs, ranks=True) for _ in range(draws)]
    return np.ptp(result) if np.isfinite(result).all() else 0.0


def test_golden_tables_in_compat_mode(golden):
    for where, case in golden.entries("compat", "cases"):
        # The reference uses only as many real tiles as there are generated ones.
        number = min(len(case["gen"]["tiles"]), len(case["real"]["tiles"]))
        sides = []
        for side in (case["gen"], case["real"]):
            scenes = side["tiles"] if side is case["gen"] else side["tiles"][:number]
            sides.append(add(golden.sums(side["set"], side["agents"], tile) for tile in scenes))
        row = table(*sides)
        assert set(row) == set(case["scaled"])
        for name, value in case["scaled"].items():
            close(row[name], value, f"{where}, {name}")


def test_golden_steps_of_single_tiles(golden):
    for where, case in golden.entries("compat", "tiles"):
        scene = golden.tiles(case["set"], "main")[case["tile"]]
        lanes = compact_lanes(scene)
        adjacency = key_points(lanes, "compat")
        reach, hops = reach_and_hops(adjacency)
        counts = (len(lanes.points), len(lanes.edges), len(adjacency), hops.sum(), len(hops))
        names = ("compact_lanes", "compact_edges", "key_points", "hops_sum", "hops_n")
        assert counts == tuple(case[name] for name in names), where
        assert sorted(degrees(adjacency)) == case["degrees_sorted"], where
        assert sorted(reach) == case["reach_sorted"], where
        close(route_length(lanes, "compat"), case["route_length"], where)
        close(endpoint_gaps(lanes).sum(), case["endpoint_dist_sum"], where)


def test_golden_box_overlaps(golden):
    for where, case in golden.entries("design", "obb"):
        scene = golden.tiles(case["set"], case["agents"])[case["tile"]]
        agents = scene.agents.astype(np.float64)
        pairs = np.argwhere(np.triu(overlaps(agents)))
        area = intersection_areas(agents[pairs[:, 0]], agents[pairs[:, 1]])
        pairs, area = pairs[area > TOLERANCE], area[area > TOLERANCE]
        size = agents[:, 6] * agents[:, 7]
        iou = area / (size[pairs].sum(1) - area)
        close(np.column_stack([pairs, area, iou]), np.array(case["pairs"]).reshape(-1, 4), where)
        cars = (scene.agent_types[pairs] == AgentType.VEHICLE).all(1)
        flags = [bool(len(pairs)), bool((iou > 0.01).any()), bool((iou > 0.1).any()), bool(cars.any())]
        assert flags == [bool(flag) for flag in case["flags_scene_any_iou01_iou10_veh"]], where


def test_golden_matches(golden):
    for where, case in golden.entries("design", "match"):
        pairs = list(zip(golden.scenes(case["ref"]), golden.scenes(case["gen"]), strict=True))
        ego = has_ego(case["gen"]["set"])
        sums = pool(match(reference, generated, generated_ego=ego) for reference, generated in pairs)
        for k, metres in enumerate((1, 2, 3)):
            assert sums[f"recall_{metres}m"] == (case["tp_array_order_1_2_3m"][k], case["n_gt"]), where
            assert sums[f"precision_{metres}m"][1] == case["n_pred"], where
        result = match_summary(sums)
        ordered = [detections(reference, generated, generated_ego=ego) for reference, generated in pairs]
        assert [sum(int(d.hit[:, k].sum()) for d in ordered) for k in range(3)] == case["tp_egodist_order_1_2_3m"]
        precision = average_precision(ordered)
        for ours, name in (
            (result["M"], "M_R"),
            (result["P"], "P"),
            (result["PxR"], "PxR"),
            (precision["nuscenes"], "nuscenes_ap_egodist"),
            (precision["interp101"], "interp101_ap_egodist"),
        ):
            close(ours, case[name], f"{where}, {name}")


def standard(content):
    norm = content["design"]["descriptor_norm"]
    return Standard(*(Descriptor(*(np.array(norm[level][name]) for level in LEVELS)) for name in ("mean", "std")))


def test_golden_descriptors(golden):
    for where, case in golden.entries("design", "descriptors"):
        scene = golden.tiles(case["set"], "main")[case["tile"]]
        ours = describe(scene, ego=has_ego(case["set"]))
        for level in LEVELS:
            close(getattr(ours, level)[0], case[level], f"{where}, {level}")


def test_golden_descriptor_norm_is_that_of_the_shared_tiles(golden):
    for content in golden.files.values():
        if "descriptor_norm" not in content.get("design", {}) or "shared_real_1239" not in str(
            content["design"]["descriptor_norm"].get("name")
        ):
            continue
        ours, theirs = Standard.of(describe(golden.tiles("train", "main"))), standard(content)
        for level in LEVELS:
            close(getattr(ours.mean, level), getattr(theirs.mean, level), level)
            close(getattr(ours.deviation, level), getattr(theirs.deviation, level), level)


def test_golden_control(golden):
    for name, content in golden.files.items():
        for case in content.get("design", {}).get("control", []):
            unit = standard(content)
            reference = unit(describe(golden.scenes(case["ref"])))
            generated = unit(describe(golden.scenes(case["gen"]), ego=has_ego(case["gen"]["set"])))
            shuffles = np.array(case["derangements"])
            pairs = scene_pairs(list(golden.clusters(case["ref"])), np.random.default_rng(0))
            for level in LEVELS:
                ours, theirs, want = getattr(generated, level), getattr(reference, level), case["result"][level]
                where = f"{name}: {case['name']}, {level}"
                close(ccs(theirs, ours), want["CCS"], where)
                close(spg(theirs, ours, shuffles), want["SPG"], where)
                close(csc(theirs, ours, pairs), want["CSC"], where)
                rounding = rank_rounding(theirs, ours, pairs)
                assert rounding < 1e-3, where
                close(csc(theirs, ours, pairs, ranks=True), want["CSC_spearman"], where, rounding=rounding)
