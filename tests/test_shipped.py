"""The model in the package: complete, of the synthetic world alone, within its bounds."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import scjax
from scjax.cli.demo import PROMPTS
from scjax.data.synthetic.domains import DOMAINS
from scjax.model import SHIPPED


@pytest.fixture(scope="module")
def model():
    return scjax.load()


def test_files_stay_small():
    sizes = [path.stat().st_size / 1e6 for path in SHIPPED.iterdir()]
    assert max(sizes) <= 16 and sum(sizes) <= 60


def test_every_part_is_there_and_finite(model):
    for part in (model.autoencoder, model.denoiser, model.counter):
        assert part is not None and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(part))
    assert model.counts is not None and model.text_encoder


def test_it_knows_the_synthetic_world_alone_and_says_so(model):
    assert set(model.domains) <= {domain.name for domain in DOMAINS}
    assert model.notes["data"] == "the synthetic world of scjax, nothing else"
    assert (SHIPPED / "README.md").is_file()


def test_the_demo_needs_no_encoder(model):
    assert set(PROMPTS) <= set(model.prompts)
    assert all(np.isfinite(features).all() for features in model.prompts.values())
