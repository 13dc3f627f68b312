"""Options of the mechanisms by name, their checks, and the sizes of the modules that they build."""

from __future__ import annotations

import jax
import pytest

from scjax.nn.cross_attention import (
    OPTIONS,
    ContextSpec,
    CrossGlobalOptions,
    build_cross_attention,
    from_name,
    to_config,
)
from scjax.nn.cross_attention.base import one_of
from scjax.nn.functional import count
from scjax.nn.init import ParamInit
from tests.factories.attention_cases import TEXT, module


@pytest.mark.parametrize("name", OPTIONS)
def test_options_round_trip_by_name(name):
    default = OPTIONS[name]()
    assert from_name(**to_config(from_name(name))) == default and hash(default) == hash(from_name(name))


def test_from_name_suggests_the_nearest_name():
    with pytest.raises(ValueError, match=r"did you mean 'windowed'\? choose one of none, concat, full"):
        from_name("windowd")


def test_from_name_rejects_unknown_fields():
    with pytest.raises(ValueError, match="windowed has no option width: it has window, alignment"):
        from_name("windowed", width=3)


@pytest.mark.parametrize(
    ("name", "fields", "message"),
    [
        ("windowed", {"window": -1}, "at least 0"),
        ("saap", {"probes": 33}, "probes is 33"),
        ("squeezed", {"keep": 0.0}, "share of the keys"),
        ("full", {"inner_ratio": 0}, "inner_ratio"),
        ("full", {"chunk": True}, "integer"),
    ],
)
def test_options_reject_bad_values(name, fields, message):
    with pytest.raises(ValueError, match=message):
        from_name(name, **fields)


def test_one_of_names_the_class_and_the_choices():
    with pytest.raises(ValueError, match=r"CrossGlobalOptions.style must be one of 'a', 'b', not 'code'"):
        one_of(CrossGlobalOptions(), style=("a", "b"))


def test_build_rejects_grid_bias_for_text():
    with pytest.raises(ValueError, match="image's grid"):
        build_cross_attention(from_name("agent", grid_bias=True), 8, 2, TEXT, init=ParamInit())


def test_build_rejects_widths_that_heads_do_not_divide():
    with pytest.raises(ValueError, match="multiple of heads"):
        build_cross_attention(from_name("full"), 9, 2, TEXT, init=ParamInit())


@pytest.mark.parametrize("fields", [{"kind": "image"}, {"grid": (2, 2)}, {"modalities": 2}])
def test_context_spec_rejects_contradictions(fields):
    with pytest.raises(ValueError, match="ContextSpec"):
        ContextSpec(**fields)


@pytest.mark.parametrize(
    ("name", "fields", "parameters"),
    [
        ("concat", {}, lambda d: 4 * d * d + 8 * d + d),
        ("full", {}, lambda d: 4 * d * d + 8 * d),
        ("gated", {}, lambda d: 4 * d * d + 8 * d + 1),
        ("linear", {}, lambda d: 4 * d * d + 5 * d),
        ("agent", {}, lambda d: 4 * d * d + 8 * d),
        ("windowed", {}, lambda d: 4 * d * d + 8 * d),
        ("squeezed", {}, lambda d: 4 * d * d + 8 * d + 1),
        ("saap", {}, lambda d: 4 * d * d + 8 * d + 8 * (d // 8 * 64 + 64 + 64 * 32 + 32 + 32 * d // 8) + 1),
        ("deformable", {}, lambda d: 2 * d * d + 2 * d + (d + 1) * (2 + 3 * 8 * 2 * 4)),
        ("cross_global", {}, lambda d: 8 * d * d + 50 * d + 1),
        ("cross_global", {"style": "paper"}, lambda d: 6 * d * d + 44 * d + 1),
    ],
)
def test_parameter_count_is_closed_form(name, fields, parameters):
    """The closed forms of the specification, at 8 heads and two 14 x 14 grids."""
    network = module(from_name(name, **fields), ContextSpec(kind="image", grid=(14, 14), modalities=2), 64, 8)
    assert count(jax.eval_shape(network.init, jax.random.key(0))) == parameters(64)


def test_wide_full_has_the_parameters_of_cross_global():
    sizes = [
        count(jax.eval_shape(module(from_name(name, **fields), TEXT, 512, 8).init, jax.random.key(0)))
        for name, fields in (("full", {"inner_ratio": 2}), ("cross_global", {}))
    ]
    assert sizes[1] == 2_122_753 and abs(sizes[0] / sizes[1] - 1) < 0.01
