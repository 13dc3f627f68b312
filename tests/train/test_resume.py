"""What a run may change when it continues, and checkpoints that are damaged or old."""

from __future__ import annotations

import copy
import gc
import json
import random
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.train.checkpoint import Checkpoints, check_resume
from scjax.train.resume import compare_runs, params_hash
from tests.factories.small_runs import get_config

CONFIG = json.loads(get_config("denoiser").to_json())
INPUTS = {"records": "11", "autoencoder": "22"}
STATE = {"a": jnp.arange(1000.0) * 1.1, "b": jax.random.normal(jax.random.key(0), (3000,)), "key": jax.random.key(3)}
POSITION = {"next": 12, "waiting": {"0": [3, 4]}}


def changed(**fields):
    config = copy.deepcopy(CONFIG)
    for name, value in fields.items():
        *path, last = name.split("__")
        table = config
        for part in path:
            table = table[part]
        assert last in table
        table[last] = value
    return config


@pytest.fixture(scope="module", autouse=True)
def quick_collection():
    """A restore that fails collects garbage: what is there before these tests is not searched every time."""
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Checkpoints of the steps 3 and 6."""
    folder = tmp_path_factory.mktemp("resume") / "checkpoints"
    with Checkpoints(folder, CONFIG, INPUTS) as checkpoints:
        checkpoints.save(3, STATE, POSITION)
        checkpoints.save(6, STATE, POSITION)
    return folder


@pytest.fixture
def folder(saved, tmp_path):
    """A copy of them, to be damaged."""
    return shutil.copytree(saved, tmp_path / "checkpoints")


@pytest.mark.parametrize(
    "fields",
    [
        {"objective": "autoencoder"},
        {"condition": "text"},
        {"seed": 1},
        {"sharding": "fsdp"},
        {"freeze": True},
        {"ema_decay": 0.5},
        {"model__lane_width": 16},
        {"cross_attention": "windowed"},
        {"cross_attention_options__cross_global__latent_tokens": 4},
        {"batch__batch_size": 4},
        {"batch__seed": 1},
        {"batch__crops": [1.0, 0.0, 0.0]},
        {"optimizer__learning_rate": 1.0},
        {"optimizer__kind": "muon"},
        {"loss__label_dropout": 0.5},
        {"position_head_fit__steps": 3},
        {"steps": 8},
    ],
)
def test_compare_runs_names_fields_that_shape_a_run(fields):
    differences = compare_runs(CONFIG, INPUTS, changed(**fields), INPUTS)
    assert f"config.{next(iter(fields)).replace('__', '.')} is" in "; ".join(differences)


@pytest.mark.parametrize(
    "fields",
    [
        {"steps": 10},
        {"log_every": 1, "checkpoint_every": 1, "evaluate_every": 0, "picture_every": 0},
        {"export_at": [1], "tensorboard": True},
        {"batch__workers": 2},
        {"records": "moved", "autoencoder": "moved"},
        {"cross_attention_options__windowed__window": 8},
    ],
)
def test_compare_runs_allows_what_shapes_nothing(fields):
    assert compare_runs(CONFIG, INPUTS, changed(**fields), INPUTS) == []


@pytest.mark.parametrize("inputs", [{**INPUTS, "records": "12"}, {"records": "11"}, {**INPUTS, "init_from": "3"}])
def test_compare_runs_names_inputs_of_another_content(inputs):
    (difference,) = compare_runs(CONFIG, INPUTS, CONFIG, inputs)
    assert "the content of config." in difference
    assert compare_runs(CONFIG, None, CONFIG, inputs) == []  # the checkpoint is older than the hashes


def test_params_hash_depends_on_paths_types_and_values():
    trees = [{"a": np.zeros(2)}, {"b": np.zeros(2)}, {"a": np.ones(2)}, {"a": np.zeros(2, np.float32)}]
    assert len({params_hash(tree) for tree in trees}) == 4


def test_check_resume_names_fields_and_cure(folder):
    with pytest.raises(ValueError, match=r"config\.seed is 0 there and 1 here.*Give its values, or another --workdir"):
        check_resume(folder, changed(seed=1), INPUTS)
    assert check_resume(folder, CONFIG, INPUTS)["inputs"] == INPUTS
    assert check_resume(folder / "nowhere", CONFIG, INPUTS) == {}


def test_restore_reads_checkpoints_without_facts(folder):
    path = folder / "step_6" / "config" / "metadata"
    content = json.loads(path.read_text())
    del content["checkpoint"]
    path.write_text(json.dumps(content))
    with Checkpoints(folder, CONFIG, {"records": "another"}) as checkpoints:
        state, data = checkpoints.restore(STATE)
    assert data == POSITION
    np.testing.assert_array_equal(state["b"], STATE["b"])


@pytest.mark.parametrize("name", ["config/metadata", "data/metadata", "state/_METADATA", "state/manifest.ocdbt"])
@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe"])
def test_restore_names_a_damaged_checkpoint(folder, name, content):
    (folder / "step_6" / name).write_bytes(content)
    with Checkpoints(folder, CONFIG, INPUTS) as checkpoints, pytest.raises(ValueError, match=r"delete .*step_6: the"):
        checkpoints.restore(STATE)
    shutil.rmtree(folder / "step_6")
    with Checkpoints(folder, CONFIG, INPUTS) as checkpoints:
        assert checkpoints.latest == 3 and checkpoints.restore(STATE)[1] == POSITION


def test_restore_notices_another_position_or_state(folder):
    (folder / "step_6" / "data" / "metadata").write_text(json.dumps({**POSITION, "next": 13}))
    with Checkpoints(folder, CONFIG, INPUTS) as checkpoints, pytest.raises(ValueError, match="another checksum"):
        checkpoints.restore(STATE)


def test_use_position_names_a_damaged_checkpoint(folder):
    with (
        Checkpoints(folder, CONFIG, INPUTS) as checkpoints,
        pytest.raises(ValueError, match=r"step 6 .*data position.*delete"),
    ):
        checkpoints.use_position(lambda position: position["nothing"], POSITION)


def test_restore_of_random_damage_works_or_names_the_step(folder, tmp_path):
    rng = random.Random(0)
    files = sorted(path.relative_to(folder) for path in (folder / "step_6").rglob("*") if path.is_file())
    for number in range(20):
        copied = tmp_path / str(number)
        shutil.copytree(folder, copied)
        path = copied / files[number % len(files)]
        data = bytearray(path.read_bytes())
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data if rng.random() < 0.5 else data[: rng.randrange(len(data))])
        try:
            with Checkpoints(copied, CONFIG, INPUTS) as checkpoints:
                state, _ = checkpoints.restore(STATE)
        except ValueError as error:
            assert "step_6" in str(error) or "another run" in str(error), error
        else:
            np.testing.assert_array_equal(state["b"], STATE["b"])
