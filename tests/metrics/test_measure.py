"""One pass gives what the metrics give one by one; parts merge; a copy scores fully."""

import numpy as np
import pytest

from scjax.metrics.distributions import add, scene_sums, table
from scjax.metrics.measure import (
    MODES,
    also_values,
    control_values,
    distribution_values,
    match_values,
    measure,
    precision_values,
    scene_values,
)
from scjax.metrics.measured import SceneStats, merged
from scjax.metrics.placement import placement
from scjax.metrics.realism import realism
from scjax.scene import Crop
from tests.factories.traffic import agent, scene
from tests.metrics.test_distributions import traffic

SCENES = [traffic(seed) for seed in range(12)]
OTHERS = [traffic(seed) for seed in range(20, 32)]
PLACES = [f"place {k // 2}" for k in range(12)]


@pytest.fixture(scope="module")
def whole():
    return measure(SCENES, PLACES, OTHERS)


def test_one_pass_is_every_metric(whole):
    theirs = measure(OTHERS, PLACES)
    for mode in MODES:
        want = table(*(add(scene_sums(s, mode) for s in side) for side in (SCENES, OTHERS)))
        found = distribution_values(whole.tally.total, theirs.tally.total, mode)
        assert found == pytest.approx(want, rel=1e-9)
    shown = scene_values(whole.tally.total)
    for name, value in realism(SCENES).items():
        assert shown[name] == pytest.approx(value, nan_ok=True), name
    pairs = list(zip(OTHERS, SCENES, strict=True))
    assert match_values(whole.tally.total) == pytest.approx(placement(pairs))


def test_parts_are_the_whole(whole):
    parts = [measure(SCENES[k : k + 5], PLACES[k : k + 5], OTHERS[k : k + 5]) for k in (0, 5, 10)]
    joined = merged(parts)
    assert joined.clusters == whole.clusters
    for mode in MODES:
        assert distribution_values(joined.tally.total, whole.tally.total, mode)["frechet_reach"] == pytest.approx(0)
    for one, two in zip(joined.descriptors, whole.descriptors, strict=True):
        np.testing.assert_array_equal(one, two)
    assert precision_values(joined) == precision_values(whole)


def test_a_copy_scores_fully_and_another_set_does_not():
    reference = measure(OTHERS, PLACES)
    copy, other = measure(OTHERS, PLACES, OTHERS), measure(SCENES, PLACES, OTHERS)
    assert match_values(copy.tally.total)["M"] == 1 and precision_values(copy)["AP interp101"] == pytest.approx(1)
    full, some = control_values(copy, reference), control_values(other, reference)
    for level in ("lane", "agent", "glob"):
        assert full[f"{level} CCS"] == pytest.approx(1) and full[f"{level} CSC"] == pytest.approx(1)
        assert some[f"{level} CCS"] < 1 and some[f"{level} CSC"] < 0.9
    assert match_values(other.tally.total)["M"] < 0.3


def test_overlaps_by_how_much():
    made = scene([agent(0, 0), agent(3.9, 0), agent(20, 0), agent(21, 0)])
    shown = scene_values(measure([made], ["a"]).tally.total)
    assert shown["scenes_any_overlap"] == shown["scenes_overlap_iou_0.1"] == 1
    grazing = scene_values(measure([scene([agent(0, 0), agent(3.97, 0)])], ["a"]).tally.total)
    assert grazing["scenes_any_overlap"] == 1 and grazing["scenes_overlap_iou_0.01"] == 0


def test_nothing_is_measured_as_nothing():
    empty = measure([], [])
    assert len(empty) == 0 and empty.tally.total == {} and merged([empty, empty]).clusters == []
    bare = measure([scene(), scene([agent(0, 0)])], ["a", "b"])
    assert bare.tally.total["strict/scenes_without_lanes"] == 2 and np.isfinite(bare.descriptors.glob).all()


def test_lengths_must_agree(whole):
    with pytest.raises(ValueError, match="1 references but more scenes"):
        measure(SCENES[:2], PLACES[:2], OTHERS[:1])
    with pytest.raises(ValueError, match="zip"):
        measure(SCENES[:2], PLACES[:1])
    with pytest.raises(ValueError, match="12 scenes but 1 references"):
        control_values(whole, measure(OTHERS[:1], PLACES[:1]))


def test_a_file_keeps_everything(whole, tmp_path):
    siblings = [[SCENES[k - 1]] for k in range(12)]
    made = measure(SCENES, PLACES, OTHERS, siblings=siblings, also=lambda scene, reference: {"twice": (2.0, 1.0)})
    made.save(tmp_path / "part.npz")
    again = SceneStats.load(tmp_path / "part.npz")
    assert again.clusters == PLACES and again.shown.keys() == made.shown.keys()
    np.testing.assert_array_equal(again.shown["M"], made.shown["M"])
    assert also_values(again.tally.total) == {"twice": 2.0}
    assert precision_values(again) == precision_values(made)
    assert set(precision_values(made)) > set(precision_values(whole))
    assert match_values(again.tally.total) == match_values(whole.tally.total)
    assert match_values(made.tally.total, "match_any_class")["M"] >= match_values(made.tally.total)["M"]
    assert control_values(again, whole) == control_values(made, whole)
    bare = measure(SCENES[:1], PLACES[:1])
    bare.save(tmp_path / "bare.npz")
    assert SceneStats.load(tmp_path / "bare.npz").detections == []
    (tmp_path / "cut.npz").write_bytes((tmp_path / "part.npz").read_bytes()[:500])
    with pytest.raises(ValueError, match=r"cut.npz holds no measured scenes .* evaluate again"):
        SceneStats.load(tmp_path / "cut.npz")


def test_another_frame_shows_and_another_window_is_refused():
    turned = scene([agent(0, 0, 90), agent(3, 4)])
    shown = scene_values(measure([turned, scene([agent(3, 4)])], ["a", "b"]).tally.total)
    assert shown["ego_turned"] == 0.5 and shown["ego_away_m"] == pytest.approx(2.5)
    ahead = turned.replace(crop=np.int32(Crop.FORWARD))
    assert np.isnan(scene_values(measure([ahead], ["a"]).tally.total)["ego_away_m"])
    with pytest.raises(ValueError, match="a FORWARD scene has a CENTRED reference"):
        measure([ahead], ["a"], [turned])
