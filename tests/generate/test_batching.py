"""Batches of few shapes: every scene once, in its bucket."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scjax.generate import batching
from scjax.generate.batching import BUCKETS, in_batches, least_size, padded_size


@pytest.fixture(scope="module", autouse=True)
def all_buckets():
    """Those of users, which other tests do without."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batching, "BUCKETS", BUCKETS)
        yield


@given(st.lists(st.tuples(st.integers(0, 61), st.integers(0, 100)), max_size=30), st.integers(1, 5))
def test_in_batches_holds_every_scene_once(sizes, group):
    indices, filled = [], 0
    for bucket, part, rows in in_batches(sizes, group):
        assert len(rows) == group and rows[: len(part)] == part and set(rows) == set(part)
        assert all(sizes[index][0] <= bucket[0] and sizes[index][1] <= bucket[1] for index in part)
        indices += part
        filled += group > len(part)
    assert sorted(indices) == list(range(len(sizes))) and filled <= 1


def test_few_scenes_of_several_sizes_share_a_batch():
    batches = list(in_batches([(2, 2), (40, 50), (11, 6), (3, 3)], 4))
    assert batches == [((61, 64), [0, 3, 2, 1], [0, 3, 2, 1])]


def test_many_scenes_have_their_own_size():
    sizes = [(2, 2)] * 9 + [(11, 6)] * 3
    assert [(bucket, len(part)) for bucket, part, _ in in_batches(sizes, 4)] == [((8, 8), 4)] * 2 + [((16, 16), 4)]


def test_padded_size_is_the_smallest_bucket():
    for agents, lanes in BUCKETS:
        assert padded_size(agents, lanes) == (agents, lanes)
    assert padded_size(9, 3) == (16, 16) and padded_size(3, 29) == (32, 32) and padded_size(33, 1) == (61, 48)
    with pytest.raises(ValueError, match="62 agents and 1 lanes are more than"):
        padded_size(62, 1)


def test_padded_size_holds_the_least_slots():
    assert padded_size(2, 2, (9, 26)) == (16, 28) and padded_size(2, 40, (16, 28)) == (61, 48)
    assert [bucket for bucket, *_ in in_batches([(2, 2), (11, 6), (9, 26)], 4, (16, 28))] == [(16, 28)]


@pytest.mark.parametrize(("value", "size"), [(None, (0, 0)), ((16, 28), (16, 28)), ([np.int64(4), 8], (4, 8))])
def test_least_size_reads_pairs(value, size):
    assert least_size(value) == size


@pytest.mark.parametrize("value", [(1, 2, 3), (16,), 28, "16x28", (1.5, 2), (-1, 4)])
def test_least_size_names_the_option(value):
    with pytest.raises(ValueError, match="padded_size"):
        least_size(value)
