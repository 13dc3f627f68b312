"""Trainings begin with a model's parameters: label rows by name of the domain, nothing of another autoencoder."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.nn.functional import flatten
from scjax.synthetic.source import Worlds
from scjax.train.objectives import make_objective
from scjax.train.warm_start import SHIPPED, denoiser_base, load_init_model, warm_start
from tests.factories.small_runs import get_config
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def base():
    model = dataclasses.replace(tiny_model(), domains=("here", "there"))
    params = {**model.denoiser.params, "position_heads": {"agents": np.ones(3, np.float32)}}
    return model.with_component("denoiser", model.denoiser.config, params)


def test_denoiser_base_keeps_rows_of_known_domains(base):
    rows = np.asarray(base.denoiser.params["labels"])  # domain within layout, then the null row
    same = denoiser_base(base, base.autoencoder.params, ["here", "there"])
    assert all(np.array_equal(value, flatten(base.denoiser.params)[path]) for path, value in flatten(same).items())
    mixed = denoiser_base(base, base.autoencoder.params, ["elsewhere", "there", "here"])["labels"]
    np.testing.assert_array_equal(mixed, rows[[6, 1, 0, 6, 3, 2, 6, 5, 4, 6]])
    np.testing.assert_array_equal(denoiser_base(base, base.autoencoder.params, [])["labels"], rows[[6, 6, 6, 6]])


def test_denoiser_base_drops_position_heads_of_another_autoencoder(base):
    other = jax.tree.map(lambda x: x + 1, base.autoencoder.params)
    assert "position_heads" in denoiser_base(base, base.autoencoder.params, base.domains)
    assert "position_heads" not in denoiser_base(base, other, base.domains)
    assert "position_heads" in base.denoiser.params


def test_warm_start_rejects_other_networks_and_sizes(base):
    with pytest.raises(ValueError, match="no denoiser"):
        denoiser_base(base.without("denoiser"), base.autoencoder.params, [])
    with pytest.raises(ValueError, match=r"config\.init_from: its parameter labels \(7, .*does not fit"):
        warm_start({"labels": np.zeros((7, 1))}, {"labels": base.denoiser.params["labels"]})


def test_autoencoder_starts_from_another(tmp_path):
    build_records(Worlds(2, 3), tmp_path / "records", BuildOptions(split_percent=50.0))
    start = tiny_model()
    scjax.save(start.without("denoiser"), tmp_path / "start")
    config = get_config("autoencoder")
    config.records, config.init_from = str(tmp_path / "records"), str(tmp_path / "start")
    config.model.update(dataclasses.asdict(start.autoencoder.config))
    params = make_objective(config).init(jax.random.key(5))
    chex.assert_trees_all_equal(jax.device_get(params), start.autoencoder.params)


def test_load_init_model_knows_the_shipped_model():
    assert load_init_model(SHIPPED).domains == scjax.load().domains
