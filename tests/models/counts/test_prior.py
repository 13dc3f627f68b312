"""The joint table of counts: smooth, normalised, and drawn from under every restriction."""

import numpy as np
import pytest

from scjax.models.counts.prior import count_table, draw_counts
from scjax.scene import Crop

ROWS = [(0, Crop.CENTERED, 10, 5)] * 3 + [(1, Crop.CENTERED, 30, 20)]


def test_count_table_is_a_distribution():
    table = count_table(ROWS, 2)
    assert table.shape == (2, 3, 101, 62)
    assert table.sum() == pytest.approx(1, abs=1e-5)
    assert table.sum((1, 2, 3)) == pytest.approx([0.75, 0.25], abs=1e-5)
    assert table[:, :, 0].sum() == 0 and table[:, :, :, 0].sum() == 0
    assert table[0, 0, 10, 5] == table[0, 0].max()


def test_draw_counts_respects_restrictions():
    table, rng = count_table(ROWS, 2), np.random.default_rng(0)
    init = np.array([draw_counts(rng, table, Crop.CENTERED) for _ in range(2000)])
    assert (init[:, 0] == 0).mean() == pytest.approx(0.75, abs=0.04)
    assert init[init[:, 0] == 0, 1].mean() == pytest.approx(10, abs=0.5)
    for _ in range(50):
        assert draw_counts(rng, table, Crop.CENTERED, domain=1, num_agents=19)[::2] == (1, 19)
        _, lanes, agents = draw_counts(rng, table, Crop.CENTERED, least_lanes=11, least_agents=6)
        assert lanes >= 11 and agents >= 6


def test_draw_counts_falls_back_for_rare_requests():
    table, rng = count_table(ROWS, 3), np.random.default_rng(0)
    domain, lanes, agents = draw_counts(rng, table, Crop.CENTERED, domain=1, num_lanes=90)
    assert (domain, lanes) == (1, 90) and 12 <= agents <= 30
    domain, lanes, agents = draw_counts(rng, table, Crop.CENTERED, domain=2)
    assert domain == 2 and lanes > 5 and agents > 2
    assert draw_counts(rng, np.zeros_like(table), Crop.CENTERED, num_lanes=4, least_agents=3)[1:] == (4, 3)


def test_draw_counts_falls_back_to_other_crops():
    table = count_table(ROWS, 2)
    assert draw_counts(np.random.default_rng(0), table, Crop.FORWARD)[1] > 1


def test_draw_counts_without_table_needs_counts():
    rng = np.random.default_rng(0)
    assert draw_counts(rng, None, Crop.CENTERED, num_lanes=4, num_agents=2) == (0, 4, 2)
    with pytest.raises(ValueError, match="num_lanes"):
        draw_counts(rng, None, Crop.CENTERED, num_agents=2)
