"""Image encoders: tokens, and strict loading of folders."""

from __future__ import annotations

import json
import random

import jax
import ml_dtypes
import numpy as np
import pytest
import safetensors.numpy

from scjax.encoders import dpt_weights, vit_weights
from scjax.encoders.base import pure_functions
from scjax.encoders.depth import DEPTH_NETWORKS
from scjax.encoders.hub_folder import find_network_folder
from scjax.encoders.image_network import load_network
from scjax.encoders.preprocessing import LETTERBOX, SQUASH, WIDE, Preprocessing
from scjax.encoders.vision import IMAGE_NETWORKS, load_image_encoder
from scjax.nn.functional import count
from tests.factories.image_folders import CONFIGS, network_state, picture, write_network


def test_image_alone_equals_image_among_others(tmp_path):
    encoder = load_image_encoder(write_network(tmp_path))
    pictures = [picture(seed=seed) for seed in range(9)]
    for one, pixels in zip(encoder(pictures), pictures, strict=True):
        np.testing.assert_allclose(one.tokens, encoder([pixels])[0].tokens, atol=2e-4)
        assert one.tokens.shape == (196, encoder.width) and one.mask.all() and one.grid == (14, 14)


@pytest.mark.parametrize("preprocessing", [LETTERBOX, WIDE, Preprocessing("one", 1, 3)])
def test_tokens_fill_the_grid(tmp_path, preprocessing):
    (tokens,) = load_image_encoder(write_network(tmp_path, "dinov3_vit"))([picture()], preprocessing)
    assert tokens.tokens.shape == (preprocessing.rows * preprocessing.columns, 16)
    assert (tokens.tokens[~tokens.mask] == 0).all() and np.isfinite(tokens.tokens).all()
    assert tokens.mask.all() == (preprocessing != LETTERBOX)


@pytest.mark.parametrize("kind", ["dinov2", "dinov3_vit"])
def test_tokens_depend_on_place(tmp_path, kind):
    (tokens,) = load_image_encoder(write_network(tmp_path, kind))([np.full((20, 30, 3), 90, np.uint8)])
    assert np.abs(tokens.tokens - tokens.tokens[:1]).max() > 1e-4


def test_bfloat16_is_near_float32(tmp_path):
    exact, rounded = (
        load_image_encoder(write_network(tmp_path), compute=compute) for compute in ("float32", "bfloat16")
    )
    (a,), (b,) = (encoder([picture()]) for encoder in (exact, rounded))
    error = np.abs(a.tokens - b.tokens).max() / a.tokens.std()
    assert 0 < error < 0.05 and b.tokens.dtype == np.float32
    assert exact.name == rounded.name and exact.key != rounded.key


@pytest.mark.parametrize(
    ("kind", "prefix"), [("dinov2", "dinov2."), ("dinov3_vit", "model."), ("dinov3_vit", "dinov3_vit.")]
)
def test_load_reads_prefixed_keys(tmp_path, kind, prefix):
    plain = load_image_encoder(write_network(tmp_path / "plain", kind))
    prefixed = load_image_encoder(write_network(tmp_path / "prefixed", kind, prefix=prefix))
    assert plain.name == prefixed.name
    np.testing.assert_array_equal(plain([picture()])[0].tokens, prefixed([picture()])[0].tokens)


def test_load_reads_names_of_transformers_5(tmp_path):
    state = network_state("dinov2")
    names = {"attention.attention.query": "attention.q_proj", "attention.output.dense": "attention.o_proj"}
    names |= {"attention.attention.key": "attention.k_proj", "attention.attention.value": "attention.v_proj"}
    for old, new in names.items():
        state = {name.replace(old, new): value for name, value in state.items()}
    plain = load_image_encoder(write_network(tmp_path / "plain"))
    folder = write_network(tmp_path / "renamed")
    safetensors.numpy.save_file(state, folder / "model.safetensors")
    assert load_image_encoder(folder).name == plain.name


def test_load_reads_shards(tmp_path):
    whole = load_image_encoder(write_network(tmp_path / "whole"))
    assert load_image_encoder(write_network(tmp_path / "shards", shards=3)).name == whole.name


def test_load_names_a_missing_shard(tmp_path):
    folder = write_network(tmp_path, shards=2)
    (folder / "model-00002-of-00002.safetensors").unlink()
    with pytest.raises(ValueError, match=r"model-00002-of-00002\.safetensors: cannot be read"):
        load_image_encoder(folder)


@pytest.mark.parametrize("dtype", [np.float16, ml_dtypes.bfloat16])
def test_load_reads_half_precision(tmp_path, dtype):
    exact = load_image_encoder(write_network(tmp_path / "exact"))
    folder = write_network(tmp_path / "half")
    state = {name: value.astype(dtype) for name, value in network_state("dinov2").items()}
    safetensors.numpy.save_file(state, folder / "model.safetensors")
    (a,), (b,) = exact([picture()]), load_image_encoder(folder)([picture()])
    np.testing.assert_allclose(a.tokens, b.tokens, atol=0.1)


def _changed(folder, change, kind="dinov2"):
    state = network_state(kind)
    change(state)
    safetensors.numpy.save_file(state, write_network(folder, kind) / "model.safetensors")
    return folder


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda state: state.pop("layernorm.bias"), r"missing: layernorm\.bias"),
        (lambda state: state.update(extra=np.zeros(3, np.float32)), "unexpected: extra"),
        (
            lambda state: state.update({"encoder.layer.2.norm1.bias": np.zeros(16, np.float32)}),
            r"unexpected: .*layer\.2",
        ),
        (lambda state: state.update({"layernorm.bias": np.zeros(9, np.float32)}), r"layernorm\.bias is \(9,\)"),
        (lambda state: state.update({"layernorm.bias": np.full(16, np.nan, np.float32)}), "not finite"),
        (lambda state: state.update({"layernorm.bias": np.zeros(16, np.int32)}), "int32"),
        (lambda state: state.update({"dinov2.layernorm.bias": np.zeros(16, np.float32)}), r"layernorm\.bias twice"),
    ],
)
def test_load_names_arrays_that_do_not_fit(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        load_image_encoder(_changed(tmp_path, change))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model_type": "vit"}, "model type 'vit' is not supported here: use dinov2"),
        ({"model_type": "depth_anything"}, "not supported here"),
        ({"hidden_size": "16"}, "hidden_size"),
        ({"hidden_size": 24, "num_attention_heads": 2}, "its sizes need"),
        ({"num_attention_heads": 3}, "num_attention_heads 3"),
        ({"num_hidden_layers": 3}, r"missing: encoder\.layer\.2"),
        ({"mlp_ratio": -1}, "mlp_ratio"),
        ({"mlp_ratio": 3}, r"fc1\.weight is"),
        ({"image_size": 2}, "image_size 2"),
        ({"image_size": 40}, "position_embeddings is"),
        ({"patch_size": [4, 4]}, "patch_size"),
        ({"use_swiglu_ffn": True}, "use_swiglu_ffn is True"),
        ({"hidden_act": "relu"}, "hidden_act is 'relu'"),
        ({"layer_norm_eps": 0}, "layer_norm_eps"),
    ],
)
def test_load_names_odd_fields_of_the_config(tmp_path, changes, message):
    folder = write_network(tmp_path)
    (folder / "config.json").write_text(json.dumps(CONFIGS["dinov2"] | changes))
    with pytest.raises(ValueError, match=rf"{tmp_path.name}.*{message}"):
        load_image_encoder(folder)


def test_load_reads_no_pickles(tmp_path):
    folder = write_network(tmp_path)
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")
    with pytest.raises(ValueError, match=r"pytorch_model\.bin, a file that may run programs"):
        load_image_encoder(folder)


def test_features_that_are_not_finite_are_refused(tmp_path):
    def enlarge(state):
        state["layernorm.weight"] = np.full(16, 3e38, np.float32)
        state["layernorm.bias"] = np.full(16, 3e38, np.float32)

    encoder = load_image_encoder(_changed(tmp_path, enlarge))
    with pytest.raises(ValueError, match="not finite"):
        encoder([picture()])


def _cache_entry(cache, name="facebook/dinov2-small", revisions=("abc",), main="abc"):
    entry = cache / f"models--{name.replace('/', '--')}"
    for revision in revisions:
        write_network(entry / "snapshots" / revision)
    (entry / "refs").mkdir(parents=True)
    (entry / "refs" / "main").write_text(main)
    return entry


def test_load_finds_networks_in_the_hub_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    entry = _cache_entry(tmp_path, revisions=("abc", "def"), main="def\n")
    assert find_network_folder("facebook/dinov2-small", "image encoder") == entry / "snapshots" / "def"
    assert load_image_encoder(entry).name == load_image_encoder("facebook/dinov2-small").name


def test_load_names_absent_networks(tmp_path, monkeypatch):
    monkeypatch.delenv("HF_HUB_CACHE", raising=False)
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    with pytest.raises(ValueError, match=r"not in the cache .*hub: .*`hf download facebook/dinov2-small`"):
        load_image_encoder("facebook/dinov2-small")
    with pytest.raises(ValueError, match=r"nowhere: no folder of an image encoder"):
        load_image_encoder(tmp_path / "nowhere")


@pytest.mark.parametrize("revisions", [(), ("abc", "def")])
def test_load_names_snapshots_that_are_unclear(tmp_path, revisions):
    entry = _cache_entry(tmp_path, revisions=revisions, main="other")
    (entry / "snapshots").mkdir(exist_ok=True)
    with pytest.raises(ValueError, match="snapshot"):
        load_image_encoder(entry)


def test_networks_have_the_published_sizes():
    small = {"hidden_size": 384, "num_hidden_layers": 12, "num_attention_heads": 6}
    v2 = {**small, "model_type": "dinov2", "patch_size": 14, "image_size": 518}
    depth = {"model_type": "depth_anything", "backbone_config": v2 | {"out_indices": [3, 6, 9, 12]}}
    v3 = {"model_type": "dinov3_vit", "num_register_tokens": 4}
    skip = 2 * (64 * 64 * 9 + 64)  # of the coarsest level, which has none
    published = {
        "dinov2": (vit_weights.NETWORK, v2, 22_056_576 - 384),  # the mask token is for training
        "dinov3": (vit_weights.NETWORK, v3, 21_596_544 - 384),
        "depth": (dpt_weights.NETWORK, depth, 24_785_089 - 384 - skip),
    }
    for name, (network, content, expected) in published.items():
        functions = pure_functions(network, network.read_config(content))
        assert count(jax.eval_shape(functions.init, jax.random.key(0))) == expected, name


def test_squash_is_the_default(tmp_path):
    encoder = load_image_encoder(write_network(tmp_path))
    np.testing.assert_array_equal(encoder([picture()])[0].tokens, encoder([picture()], SQUASH)[0].tokens)


BACKBONE = CONFIGS["depth_anything"]["backbone_config"]


@pytest.mark.parametrize("kind", ["dinov2", "dinov3_vit", "depth_anything"])
def test_load_of_damaged_folders_works_or_names_the_fault(tmp_path, kind):
    rng = random.Random(0)
    networks = {**IMAGE_NETWORKS, **DEPTH_NETWORKS}
    for number in range(20):
        folder = write_network(tmp_path / str(number), kind)
        path = folder / rng.choice(["config.json", "model.safetensors"])
        data = bytearray(path.read_bytes())
        place = rng.randrange(min(len(data), 3000))
        data = data[:place] if rng.random() < 0.3 else [*data[:place], rng.randrange(256), *data[place + 1 :]]
        path.write_bytes(bytes(data))
        try:
            load_network(folder, networks, "float32")
        except ValueError as error:
            assert str(folder) in str(error)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"backbone_config": None}, "backbone_config must be that of a dinov2"),
        ({"backbone_config": {"model_type": "swin"}}, "backbone_config must be that of a dinov2"),
        (
            {"backbone_config": {**BACKBONE, "out_features": None}},
            "names no layers",
        ),
        ({"backbone_config": {**BACKBONE, "out_indices": [1, 9]}}, "reads layers"),
        ({"neck_hidden_sizes": [4]}, "must be equally many"),
        ({"neck_hidden_sizes": 4}, "neck_hidden_sizes"),
        ({"neck_hidden_sizes": [4, 7]}, "its sizes need"),
        ({"reassemble_factors": [2, 0.7]}, "reassemble_factors has 0.7"),
        ({"reassemble_factors": [2, 0]}, "reassemble_factors"),
        ({"head_in_index": 0}, "head_in_index"),
        ({"patch_size": 14}, "patch_size is 14"),
        ({"depth_estimation_type": "other"}, "depth_estimation_type"),
        ({"max_depth": -1}, "max_depth"),
    ],
)
def test_load_names_odd_fields_of_depth_networks(tmp_path, changes, message):
    folder = write_network(tmp_path, "depth_anything")
    (folder / "config.json").write_text(json.dumps(CONFIGS["depth_anything"] | changes))
    with pytest.raises(ValueError, match=rf"{tmp_path.name}.*{message}"):
        load_network(folder, DEPTH_NETWORKS, "float32")
