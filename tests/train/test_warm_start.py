"""Trainings begin with a model's parameters: label rows by name of the domain, nothing of another autoencoder."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

import scjax
from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.nn.functional import flatten
from scjax.synthetic.source import Worlds
from scjax.train.flat_params import FlatParams
from scjax.train.objectives.autoencoder import build as autoencoder_stage
from scjax.train.warm_start import SHIPPED, denoiser_base, model_at, started
from tests.factories.small_runs import get_config
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def base():
    model = dataclasses.replace(tiny_model(), domains=("here", "there"))
    params = {**model.denoiser.params, "position_heads": {"agents": np.ones(3, np.float32)}}
    return model.with_component("denoiser", model.denoiser.config, params)


def test_domains_keep_their_rows_and_new_ones_begin_as_not_told(base):
    rows = np.asarray(base.denoiser.params["labels"])  # domain within layout, then the null row
    same = denoiser_base(base, base.autoencoder.params, ["here", "there"])
    assert all(np.array_equal(value, flatten(base.denoiser.params)[path]) for path, value in flatten(same).items())
    mixed = denoiser_base(base, base.autoencoder.params, ["elsewhere", "there", "here"])["labels"]
    np.testing.assert_array_equal(mixed, rows[[6, 1, 0, 6, 3, 2, 6, 5, 4, 6]])
    np.testing.assert_array_equal(denoiser_base(base, base.autoencoder.params, [])["labels"], rows[[6, 6, 6, 6]])


def test_what_reads_latents_is_left_out_on_another_autoencoder(base):
    other = jax.tree.map(lambda x: x + 1, base.autoencoder.params)
    assert "position_heads" in denoiser_base(base, base.autoencoder.params, base.domains)
    assert "position_heads" not in denoiser_base(base, other, base.domains)
    assert "position_heads" in base.denoiser.params


def test_a_base_of_another_stage_or_size_is_refused(base):
    with pytest.raises(ValueError, match="no denoiser"):
        denoiser_base(base.without("denoiser"), base.autoencoder.params, [])
    with pytest.raises(ValueError, match=r"config\.start: its parameter labels \(7, .*does not fit"):
        started({"labels": np.zeros((7, 1))}, {"labels": base.denoiser.params["labels"]})


def test_an_autoencoder_may_begin_with_another(tmp_path):
    build_records(Worlds(2, 3), tmp_path / "records", BuildOptions(split_percent=50.0))
    start = tiny_model()
    scjax.save(start.without("denoiser"), tmp_path / "start")
    config = get_config("autoencoder")
    config.records, config.start = str(tmp_path / "records"), str(tmp_path / "start")
    config.model.update(dataclasses.asdict(start.autoencoder.config))
    state = autoencoder_stage(config).init(jax.random.key(5))
    expected = FlatParams.of(start.autoencoder.params).pack(start.autoencoder.params)
    for vectors in (state.params, state.ema):
        jax.tree.map(np.testing.assert_array_equal, vectors, expected)


def test_the_model_that_ships_has_a_name():
    assert model_at(SHIPPED).domains == scjax.load().domains
