"""Closed-form work of the mechanisms against the table of the specification (§6)."""

from __future__ import annotations

import pytest

from scjax.nn.cross_attention import ContextSpec, from_name

# MFLOP a scene and module at width 2048: of the context alone, and of a step that finds it encoded.
TABLE = {
    "concat": (6577, 6131),
    "full": (6577, 3218),
    "gated": (6577, 3218),
    "agent": (6577, 2955),
    "saap": (6628, 2936),
    "windowed": (6577, 2871),
    "deformable": (3288, 1626),
    "squeezed": (6577 + 514, 2877),
    "cross_global": (7485, 4611),
}
CACHED_256 = {"full": 107, "linear": 45, "windowed": 64, "deformable": 40, "squeezed": 64, "cross_global": 133}
IMAGE = ContextSpec(kind="image", grid=(14, 14), modalities=2)


@pytest.mark.parametrize("name", TABLE)
def test_work_matches_the_specification(name):
    work = from_name(name).work(2048, 16, IMAGE, queries=161, context=392)
    assert [2e-6 * part for part in work] == pytest.approx(TABLE[name], rel=1e-3)


@pytest.mark.parametrize("name", CACHED_256)
def test_work_of_a_cached_step_at_width_256(name):
    assert 2e-6 * from_name(name).work(256, 8, IMAGE, 161, 392).attend == pytest.approx(CACHED_256[name], abs=0.6)


def test_work_of_no_mechanism_is_zero():
    assert from_name("none").work(256, 8, IMAGE, 161, 392) == (0, 0)
