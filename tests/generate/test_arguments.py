"""Arguments of ``scjax.sample`` and ``Condition``: what newcomers write is read, all else is refused by name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import scjax
from scjax.generate.conditions import Condition
from tests.factories.worlds import tiny_model

COUNTS = {"num_lanes": 3, "num_agents": 2}


def test_odd_arguments_are_refused_by_name():
    """In a process of its own: the type checks of this session would refuse them first."""
    command = [sys.executable, "-m", "tests.factories.odd_arguments"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=True)
    results = json.loads(done.stdout)
    assert results.pop(0) == ["read", "accepted", ""]
    faults = [result for result in results if result[1] != "ValueError" or result[0] not in result[2]]
    assert not faults and len(results) > 90


def test_key_may_be_its_number():
    made = [scjax.sample(key, Condition(**COUNTS), model=tiny_model(), num_steps=2) for key in (5, jax.random.key(5))]
    assert np.array_equal(made[0].agents, made[1].agents)


def test_model_may_be_its_folder(tmp_path):
    folder = scjax.save(tiny_model(), tmp_path / "model")
    assert scjax.sample(0, Condition(**COUNTS), model=folder, num_steps=2).batch_shape == (1,)


def test_nan_of_a_network_is_refused():
    model = tiny_model()
    params = jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), model.denoiser.params)
    broken = model.with_component("denoiser", model.denoiser.config, params)
    with pytest.raises(ValueError, match="NaN or infinity"):
        scjax.sample(0, Condition(**COUNTS), model=broken, num_steps=2)
