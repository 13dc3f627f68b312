"""One pass gives what the metrics give one by one; parts merge; a copy scores fully."""

import numpy as np
import pytest

from scjax.metrics.distributions import add, scene_sums, table
from scjax.metrics.measure import (
    MODES,
    control_values,
    distribution_values,
    extra_values,
    match_values,
    measure,
    precision_values,
    scene_values,
)
from scjax.metrics.placement import placement
from scjax.metrics.realism import realism
from scjax.metrics.scene_stats import SceneStats, merge_stats
from scjax.scene import Crop
from tests.factories.traffic import agent, random_traffic, scene

SCENES = [random_traffic(seed) for seed in range(12)]
OTHERS = [random_traffic(seed) for seed in range(20, 32)]
PLACES = [f"place {k // 2}" for k in range(12)]


@pytest.fixture(scope="module")
def whole():
    return measure(SCENES, PLACES, OTHERS)


def test_measure_equals_single_metrics(whole):
    theirs = measure(OTHERS, PLACES)
    for mode in MODES:
        want = table(*(add(scene_sums(s, mode) for s in side) for side in (SCENES, OTHERS)))
        result = distribution_values(whole.cluster_sums.total, theirs.cluster_sums.total, mode)
        assert result == pytest.approx(want, rel=1e-9)
    per_scene = scene_values(whole.cluster_sums.total)
    for name, value in realism(SCENES).items():
        assert per_scene[name] == pytest.approx(value, nan_ok=True), name
    pairs = list(zip(OTHERS, SCENES, strict=True))
    assert match_values(whole.cluster_sums.total) == pytest.approx(placement(pairs))


def test_merge_stats_equals_one_pass(whole):
    parts = [measure(SCENES[k : k + 5], PLACES[k : k + 5], OTHERS[k : k + 5]) for k in (0, 5, 10)]
    joined = merge_stats(parts)
    assert joined.clusters == whole.clusters
    for mode in MODES:
        assert distribution_values(joined.cluster_sums.total, whole.cluster_sums.total, mode)[
            "frechet_reach"
        ] == pytest.approx(0)
    for one, two in zip(joined.descriptors, whole.descriptors, strict=True):
        np.testing.assert_array_equal(one, two)
    assert precision_values(joined) == precision_values(whole)


def test_measure_scores_a_copy_fully():
    reference = measure(OTHERS, PLACES)
    copy, other = measure(OTHERS, PLACES, OTHERS), measure(SCENES, PLACES, OTHERS)
    assert match_values(copy.cluster_sums.total)["M"] == 1 and precision_values(copy)["AP interp101"] == pytest.approx(
        1
    )
    full, some = control_values(copy, reference), control_values(other, reference)
    for level in ("lane", "agent", "glob"):
        assert full[f"{level} CCS"] == pytest.approx(1) and full[f"{level} CSC"] == pytest.approx(1)
        assert some[f"{level} CCS"] < 1 and some[f"{level} CSC"] < 0.9
    assert match_values(other.cluster_sums.total)["M"] < 0.3


def test_measure_counts_overlaps_by_iou():
    stats = scene([agent(0, 0), agent(3.9, 0), agent(20, 0), agent(21, 0)])
    per_scene = scene_values(measure([stats], ["a"]).cluster_sums.total)
    assert per_scene["scenes_any_overlap"] == per_scene["scenes_overlap_iou_0.1"] == 1
    grazing = scene_values(measure([scene([agent(0, 0), agent(3.97, 0)])], ["a"]).cluster_sums.total)
    assert grazing["scenes_any_overlap"] == 1 and grazing["scenes_overlap_iou_0.01"] == 0


def test_measure_of_empty_and_bare_scenes():
    empty = measure([], [])
    assert len(empty) == 0 and empty.cluster_sums.total == {} and merge_stats([empty, empty]).clusters == []
    bare = measure([scene(), scene([agent(0, 0)])], ["a", "b"])
    assert bare.cluster_sums.total["strict/scenes_without_lanes"] == 2 and np.isfinite(bare.descriptors.glob).all()


def test_measure_rejects_unequal_lengths(whole):
    with pytest.raises(ValueError, match="1 references but more scenes"):
        measure(SCENES[:2], PLACES[:2], OTHERS[:1])
    with pytest.raises(ValueError, match="zip"):
        measure(SCENES[:2], PLACES[:1])
    with pytest.raises(ValueError, match="12 scenes but 1 references"):
        control_values(whole, measure(OTHERS[:1], PLACES[:1]))


def test_scene_stats_round_trip_through_a_file(whole, tmp_path):
    siblings = [[SCENES[k - 1]] for k in range(12)]
    stats = measure(
        SCENES, PLACES, OTHERS, siblings=siblings, extra_ratios=lambda scene, reference: {"twice": (2.0, 1.0)}
    )
    stats.save(tmp_path / "part.npz")
    loaded = SceneStats.load(tmp_path / "part.npz")
    assert loaded.clusters == PLACES and loaded.per_scene.keys() == stats.per_scene.keys()
    np.testing.assert_array_equal(loaded.per_scene["M"], stats.per_scene["M"])
    assert extra_values(loaded.cluster_sums.total) == {"twice": 2.0}
    assert precision_values(loaded) == precision_values(stats)
    assert set(precision_values(stats)) > set(precision_values(whole))
    assert match_values(loaded.cluster_sums.total) == match_values(whole.cluster_sums.total)
    assert match_values(stats.cluster_sums.total, "match_any_class")["M"] >= match_values(stats.cluster_sums.total)["M"]
    assert control_values(loaded, whole) == control_values(stats, whole)
    bare = measure(SCENES[:1], PLACES[:1])
    bare.save(tmp_path / "bare.npz")
    assert SceneStats.load(tmp_path / "bare.npz").detections == []
    (tmp_path / "cut.npz").write_bytes((tmp_path / "part.npz").read_bytes()[:500])
    with pytest.raises(ValueError, match=r"cut.npz holds no measured scenes .* evaluate again"):
        SceneStats.load(tmp_path / "cut.npz")


def test_measure_detects_other_frames_and_crops():
    turned = scene([agent(0, 0, 90), agent(3, 4)])
    per_scene = scene_values(measure([turned, scene([agent(3, 4)])], ["a", "b"]).cluster_sums.total)
    assert per_scene["ego_turned"] == 0.5 and per_scene["ego_away_m"] == pytest.approx(2.5)
    ahead = turned.replace(crop=np.int32(Crop.FORWARD))
    assert np.isnan(scene_values(measure([ahead], ["a"]).cluster_sums.total)["ego_away_m"])
    with pytest.raises(ValueError, match="a FORWARD scene has a CENTERED reference"):
        measure([ahead], ["a"], [turned])
