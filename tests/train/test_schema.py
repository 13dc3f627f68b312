"""Every field of a training config is checked before anything is read."""

from __future__ import annotations

import importlib
import json

import pytest

from scjax.data.loader_config import LoaderConfig
from scjax.train.configs.schema import check_config
from tests.factories.small_runs import get_config


def changed(objective, name, value):
    config = get_config(objective)
    table = config
    *path, last = name.split(".")
    for part in path:
        table = table[part]
    with config.unlocked(), config.ignore_type():
        table[last] = value
    return config


@pytest.mark.parametrize("name", ["autoencoder", "denoiser", "counts"])
def test_check_config_accepts_what_ships(name):
    module = importlib.import_module(f"scjax.train.configs.{name}")
    for variant in module.VARIANTS:
        config = module.get_config(variant)
        assert check_config(config) == json.loads(config.to_json())


@pytest.mark.parametrize(
    ("objective", "name", "value"),
    [
        ("autoencoder", "batch.batch_size", 10**12),
        ("autoencoder", "batch.batch_size", 2.0),
        ("autoencoder", "batch.buckets", ((1.5, 2),)),
        ("autoencoder", "batch.buckets", ()),
        ("autoencoder", "batch.crops", (1.0, 1.0)),
        ("autoencoder", "batch.workers", 0),
        ("autoencoder", "optimizer.learning_rate", float("nan")),
        ("autoencoder", "optimizer.clip", float("inf")),
        ("autoencoder", "optimizer.warmup", None),
        ("autoencoder", "optimizer.kind", "sgd"),
        ("autoencoder", "loss.weights", None),
        ("autoencoder", "loss.typical_counts", (1.0,)),
        ("autoencoder", "model.lane_width", True),
        ("autoencoder", "model.lane_width", 10**9),
        ("autoencoder", "codec", "no"),
        ("autoencoder", "records", 3),
        ("autoencoder", "log_every", 0),
        ("autoencoder", "checkpoint_every", 0),
        ("autoencoder", "export_at", 3),
        ("autoencoder", "seed", 2**63),
        ("denoiser", "condition", None),
        ("denoiser", "freeze", "yes"),
        ("denoiser", "loss.label_dropout", 1.5),
        ("denoiser", "ema_decay", -1.0),
        ("denoiser", "steps", 10**20),
        ("denoiser", "cross_attention_options.windowed.window", 10**9),
        ("counts", "domain_dropout", "0.3"),
        ("counts", "model.heads", 2.5),
    ],
)
def test_check_config_names_fields_out_of_range_or_of_another_type(objective, name, value):
    with pytest.raises(ValueError, match=rf"config: .*{name.split('.')[-1]}"):
        check_config(changed(objective, name, value))


@pytest.mark.parametrize(("name", "nearest"), [("batch.batchsize", "batch_size"), ("modl", "model")])
def test_check_config_suggests_the_nearest_name(name, nearest):
    with pytest.raises(ValueError, match=rf"config\.{name} is unknown: did you mean {nearest}"):
        check_config(changed("autoencoder", name, 3))


def test_check_config_refuses_values_that_are_no_json():
    with pytest.raises(ValueError, match="neither number, text, list nor table"):
        check_config(changed("autoencoder", "records", min))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("batch_size", 10**12),
        ("workers", 0),
        ("seed", -1),
        ("text_slots", 0),
        ("buckets", ((0, 4),)),
        ("buckets", ((4, 10**9),)),
        ("jitter_position", float("nan")),
        ("jitter_heading", 1e30),
        ("crops", (1.0, float("inf"), 1.0)),
    ],
)
def test_loader_config_names_fields_out_of_range(field, value):
    with pytest.raises(ValueError, match=field):
        LoaderConfig(**{field: value})
