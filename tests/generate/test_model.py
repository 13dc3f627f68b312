"""A model folder: complete round trip, refused when damaged or newer, never half-written."""

import dataclasses
import json

import jax
import numpy as np
import pytest
import safetensors.numpy

import scjax
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.generate.model import _default_model, load_model, save_model
from scjax.models.denoiser.config import ImageCondition, TextCondition
from scjax.nn.functional import flatten
from scjax.scene.per_type import PerType
from tests.factories.worlds import tiny_model


@pytest.mark.parametrize("condition", [None, TextCondition(width=6), ImageCondition(channels=3, grid=(2, 2))])
def test_round_trip(tmp_path, condition):
    model = tiny_model(condition)
    again = load_model(save_model(model, tmp_path / "model"))
    assert again.denoiser.config == model.denoiser.config
    assert again.autoencoder.config == model.autoencoder.config
    assert again.codec == model.codec
    assert again.domains == model.domains
    assert again.latents == model.latents
    for name in ("autoencoder", "denoiser"):
        ours, theirs = flatten(model.components[name].params), flatten(again.components[name].params)
        assert ours.keys() == theirs.keys()
        assert all(np.array_equal(ours[path], theirs[path]) for path in ours)
    assert np.array_equal(again.counts, model.counts)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model"]


def test_saving_replaces_the_whole_folder(tmp_path):
    folder = save_model(tiny_model(), tmp_path / "model")
    (folder / "stray").write_text("x")
    save_model(tiny_model(), folder)
    assert sorted(path.name for path in folder.iterdir()) == ["model.json", "weights.safetensors"]
    modes = {path.stat().st_mode for path in folder.iterdir()}
    assert len(modes) == 1  # the weights are as readable as the rest


def test_a_failed_save_leaves_the_old_model(tmp_path, monkeypatch):
    folder = save_model(tiny_model(), tmp_path / "model")
    before = (folder / "weights.safetensors").read_bytes()

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(OSError, match="No space"):
        save_model(tiny_model(), folder)
    assert (folder / "weights.safetensors").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model"]


def test_damage_is_named(tmp_path):
    with pytest.raises(ValueError, match="no model folder"):
        load_model(tmp_path)
    folder = save_model(tiny_model(), tmp_path / "model")
    weights = folder / "weights.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(ValueError, match="damaged"):
        load_model(folder)
    description = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps({**description, "format": 99}))
    save_model(tiny_model(), folder)
    (folder / "model.json").write_text(json.dumps({**description, "format": 99}))
    with pytest.raises(ValueError, match="format 99"):
        load_model(folder)
    del description["format"]
    (folder / "model.json").write_text(json.dumps(description))
    with pytest.raises(ValueError, match=r"model\.json: format is None, but a model with components has 2"):
        load_model(folder)


def test_the_model_that_ships_is_read_once_and_missed_plainly(tmp_path, monkeypatch):
    assert scjax.load() is scjax.load()
    _default_model.cache_clear()
    monkeypatch.setattr("scjax.generate.model.DEFAULT_MODEL", tmp_path)
    with pytest.raises(ValueError, match=r"experiments\.train"):
        scjax.sample(jax.random.key(0))


def test_a_model_keeps_how_it_is_sampled_and_older_ones_do_as_the_release(tmp_path):
    cold = dataclasses.replace(
        tiny_model(),
        temperature=PerType(agents=0.5, lanes=0.25),
        energy_guidance=EnergyGuidance(gradient_steps=3, lane_step_size=0.01),
        num_steps=8,
        guidance=1.5,
    )
    folder = save_model(cold, tmp_path / "model")
    kept = load_model(folder)
    assert kept.temperature == cold.temperature and kept.energy_guidance == cold.energy_guidance
    assert (kept.num_steps, kept.guidance) == (8, 1.5)
    description = json.loads((folder / "model.json").read_text())
    for name in ("temperature", "energy_guidance", "num_steps", "guidance"):
        del description[name]
    (folder / "model.json").write_text(json.dumps(description))
    older = load_model(folder)
    assert older.temperature == PerType(agents=1.0, lanes=0.75)
    assert older.energy_guidance is older.num_steps is older.guidance is None


@pytest.mark.parametrize(("field", "value"), [("num_steps", 1), ("num_steps", 101), ("guidance", float("nan"))])
def test_a_model_with_senseless_defaults_is_refused(tmp_path, field, value):
    with pytest.raises(ValueError, match=field):
        save_model(dataclasses.replace(tiny_model(), **{field: value}), tmp_path / "model")


def test_weights_in_several_files_of_half_precision(tmp_path):
    model = tiny_model()
    folder = save_model(model, tmp_path / "model", dtype="float16", largest=0.16)
    files = sorted(folder.glob("weights*.safetensors"))
    assert len(files) > 1 and all(file.stat().st_size < 200_000 for file in files)
    back = load_model(folder)
    for one, two in zip(jax.tree.leaves(back.denoiser.params), jax.tree.leaves(model.denoiser.params), strict=True):
        assert one.dtype == np.float32
        np.testing.assert_allclose(one, two, rtol=1e-3, atol=1e-4)
    assert np.array_equal(back.counts, model.counts)  # probabilities are too small for half precision
    with pytest.raises(ValueError, match="more than a file"):
        save_model(model, tmp_path / "other", largest=1e-5)
    assert not (tmp_path / "other").exists()
    files[0].unlink()
    with pytest.raises(ValueError, match=f"{files[0].name} is missing"):
        load_model(folder)


def _rewrite_as_format_1(folder):
    """Gives parts, config fields and arrays of a model folder the names that they had in format 1."""
    index = json.loads((folder / "model.json").read_text())
    parts = index.pop("components")
    old = {"known_embedding": "given_embedding", "relative_geometry": "hints", "cross_attention": "control"}
    parts["denoiser"] = {old.get(name, name): value for name, value in parts["denoiser"].items()}
    guidance = {
        "gradient_steps": "rounds",
        "max_sigma": "below",
        "agent_step_size": "agents",
        "lane_step_size": "lanes",
    }
    steering = {guidance.get(name, name): value for name, value in index.pop("energy_guidance").items()}
    index |= parts | {"format": 1, "representation": index.pop("codec"), "steering": steering}
    arrays = safetensors.numpy.load_file(folder / "weights.safetensors")
    for new, name in {"agent_known": "agent_given", "relative_geometry": "hints", "position_heads": "anchors"}.items():
        arrays = {path.replace(f"denoiser.{new}", f"denoiser.{name}"): array for path, array in arrays.items()}
    safetensors.numpy.save_file(arrays, folder / "weights.safetensors")
    index["files"] = {"weights.safetensors": ""}
    (folder / "model.json").write_text(json.dumps(index))


def test_load_reads_format_1(tmp_path):
    model = tiny_model(known_embedding=True, relative_geometry=True)
    model = dataclasses.replace(model, energy_guidance=scjax.EnergyGuidance(gradient_steps=3))
    folder = save_model(model, tmp_path / "model")
    _rewrite_as_format_1(folder)
    back = load_model(folder)
    assert back.denoiser.config == model.denoiser.config and back.codec == model.codec
    assert back.energy_guidance == model.energy_guidance
    assert jax.tree.structure(back.denoiser.params) == jax.tree.structure(model.denoiser.params)
    jax.tree.map(np.testing.assert_array_equal, back.denoiser.params, model.denoiser.params)


def test_save_writes_one_index_of_components(tmp_path):
    folder = save_model(tiny_model(), tmp_path / "model")
    index = json.loads((folder / "model.json").read_text())
    assert index["format"] == 2 and set(index["components"]) == {"autoencoder", "denoiser"}


def test_components_are_added_and_removed():
    model = tiny_model()
    assert set(model.without("denoiser").components) == {"autoencoder"}
    again = model.without("denoiser").with_component("denoiser", model.denoiser.config, model.denoiser.params)
    assert again.denoiser == model.denoiser
    with pytest.raises(ValueError, match="no count_predictor: train that stage"):
        _ = model.count_predictor
    with pytest.raises(ValueError, match="decoder unknown: choose from autoencoder"):
        model.with_component("decoder", None, {})
