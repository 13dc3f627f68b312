"""The converter on the golden weights: sizes inferred, both networks in one model, everything else refused."""

import json
import re

import numpy as np
import pytest
import safetensors.numpy

from scjax.convert.__main__ import main
from scjax.convert.official import convert_checkpoint, read_state
from scjax.generate.model import load_model


@pytest.fixture(scope="module")
def weights(parity_dir, tmp_path_factory):
    """Golden weights as safetensors files."""
    folder = tmp_path_factory.mktemp("weights")
    for name in ("ae", "uncond", "text", "image"):
        if not (parity_dir / f"{name}_weights.npz").exists():
            pytest.skip(f"this parity set has no {name}_weights.npz")
        with np.load(parity_dir / f"{name}_weights.npz") as file:
            arrays = {key: np.ascontiguousarray(file[key]) for key in file}
        safetensors.numpy.save_file(arrays, folder / f"{name}.safetensors")
    return folder


@pytest.fixture(scope="module")
def sizes(parity_dir):
    return json.loads((parity_dir / "config.json").read_text())


def heads(sizes, name):
    return [str(sizes[name][f"{kind}_heads"]) for kind in ("lane", "agent")]


def test_convert_completes_a_model_folder(weights, sizes, tmp_path, capsys):
    out = tmp_path / "model"
    main(["official", str(weights / "ae.safetensors"), str(out), "--heads", *heads(sizes, "autoencoder")])
    main(["official", str(weights / "text.safetensors"), str(out), "--heads", *heads(sizes, "denoiser")])
    assert "denoiser" in capsys.readouterr().out
    model = load_model(out)
    assert model.autoencoder.config.lane_width == sizes["autoencoder"]["lane_width"]
    assert model.denoiser.config.condition.width == sizes["denoiser"]["text"]["width"]
    state = read_state(weights / "ae.safetensors")
    assert np.array_equal(model.autoencoder.params["encoder"]["lane_mean"]["kernel"], state["encoder.lane_mu.weight"].T)


def test_convert_reads_wrapped_and_joint_files(weights, tmp_path):
    joined = {f"diff_model.autoencoder.{key}": value for key, value in read_state(weights / "ae.safetensors").items()}
    joined |= {f"diff_model.{key}": value for key, value in read_state(weights / "uncond.safetensors").items()}
    safetensors.numpy.save_file(joined, tmp_path / "joined.safetensors")
    model = convert_checkpoint(tmp_path / "joined.safetensors")
    assert {"autoencoder", "denoiser"} <= model.components.keys()


@pytest.mark.parametrize("name", ["uncond", "image"])
def test_convert_detects_the_condition(weights, name):
    model = convert_checkpoint(weights / f"{name}.safetensors")
    assert (model.denoiser.config.condition is None) == (name == "uncond")


def test_convert_lists_misfits_and_writes_nothing(weights, tmp_path):
    state = read_state(weights / "ae.safetensors")
    state["surprise"] = np.zeros(2, np.float32)
    state["decoder.agent_mlp.bias"] = np.zeros(3, np.float32)
    del state["encoder.lane_mu.bias"]
    safetensors.numpy.save_file(state, tmp_path / "bad.safetensors")
    with pytest.raises(SystemExit) as stop:
        main(["official", str(tmp_path / "bad.safetensors"), str(tmp_path / "out")])
    text = str(stop.value)
    assert "unexpected: surprise" in text
    assert "missing: encoder.lane_mu.bias" in text
    assert "misshapen: decoder.agent_mlp.bias" in text
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_convert_names_arrays_that_are_not_finite(weights, tmp_path, value):
    """Case 24."""
    state = read_state(weights / "ae.safetensors")
    name = sorted(state)[3]
    state[name] = np.full_like(state[name], value)
    safetensors.numpy.save_file(state, tmp_path / "x.safetensors")
    with pytest.raises(SystemExit, match=rf"{re.escape(name)} is not finite"):
        main(["official", str(tmp_path / "x.safetensors"), str(tmp_path / "out"), "--heads", "2", "2"])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda array: array.astype(np.int32), "int32, not floating-point"),
        (lambda array: np.zeros((0, *array.shape[1:]), np.float32), "has shape"),
        (lambda array: array.reshape(-1), "misshapen|axes"),
        (lambda array: array[None], "misshapen|axes"),
    ],
)
@pytest.mark.parametrize("key", ["encoder.lane_mlp.linears.0.weight", "decoder.pred_agent_types.linear_out.weight"])
def test_convert_names_arrays_of_another_type_or_shape(weights, tmp_path, key, change, message):
    state = read_state(weights / "ae.safetensors")
    state[key] = np.ascontiguousarray(change(state[key]))
    safetensors.numpy.save_file(state, tmp_path / "x.safetensors")
    with pytest.raises(ValueError, match=message):
        convert_checkpoint(tmp_path / "x.safetensors")


@pytest.mark.parametrize("numbers", [("0", "2"), ("2", "-1"), ("3", "2"), ("2", "1000000000000")])
def test_convert_refuses_heads_that_do_not_fit(weights, tmp_path, numbers):
    with pytest.raises(SystemExit, match="heads"):
        main(["official", str(weights / "ae.safetensors"), str(tmp_path / "out"), "--heads", *numbers])


def test_convert_rejects_other_files(tmp_path):
    with pytest.raises(ValueError, match="no such file"):
        read_state(tmp_path / "none.safetensors")
    (tmp_path / "cut.safetensors").write_bytes(b"\x10\x00")
    with pytest.raises(ValueError, match="no whole safetensors"):
        read_state(tmp_path / "cut.safetensors")
    safetensors.numpy.save_file({"x": np.zeros(1, np.float32)}, tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="neither an autoencoder"):
        convert_checkpoint(tmp_path / "other.safetensors")
