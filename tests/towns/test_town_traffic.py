import dataclasses

import numpy as np
import pytest

from scjax.towns.town_traffic import collect_traffic, load_traffic, save_traffic
from tests.factories.town_traffic import fork_traffic, straight_track


def test_save_and_load_keep_millimeters(tmp_path):
    traffic = dataclasses.replace(fork_traffic(straight_track(speed=7.3)), egos=np.array([[20, 0]]))
    save_traffic(traffic, tmp_path / "t.npz")
    loaded = load_traffic(tmp_path / "t.npz")
    for field in dataclasses.fields(traffic):
        before, after = getattr(traffic, field.name), getattr(loaded, field.name)
        if field.name in ("names", "signal_lanes"):
            assert before == after
        else:
            np.testing.assert_allclose(after, before, atol=6e-4)


def test_damaged_file_is_named(tmp_path):
    save_traffic(fork_traffic(), tmp_path / "t.npz")
    data = (tmp_path / "t.npz").read_bytes()
    (tmp_path / "t.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"t\.npz is no readable"):
        load_traffic(tmp_path / "t.npz")


def test_collect_traffic_cuts_tracks_to_the_recording():
    tracks = [straight_track("early", start=-30, steps=50), straight_track("late", start=290, steps=50)]
    tracks += [straight_track("gone", start=-60, steps=50), straight_track("never", start=300)]
    traffic = collect_traffic(tracks, [], np.zeros((0, 300), np.int8))
    assert traffic.names == ("early", "late") and traffic.starts.tolist() == [0, 290]
    assert np.diff(traffic.offsets).tolist() == [20, 10]
    assert traffic.positions[0, 0] == pytest.approx(15.0)


def test_rows_at_point_to_the_step():
    traffic = fork_traffic(straight_track("a"), straight_track("b", start=100, x=7.0))
    objects = traffic.objects_between(50, 51)
    assert objects.tolist() == [0] and traffic.rows_at(np.array([0, 1]), 50).tolist() == [50, -1]
    assert traffic.positions[traffic.rows_at(np.array([1]), 104)[0], 0] == pytest.approx(7 + 2.0)


def test_traffic_without_objects_and_signals_is_kept(tmp_path):
    save_traffic(collect_traffic([], [], np.zeros((0, 50), np.int8)), tmp_path / "t.npz")
    loaded = load_traffic(tmp_path / "t.npz")
    assert loaded.names == () and loaded.signal_lanes == () and loaded.num_steps == 50
