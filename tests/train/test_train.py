"""Training as users meet it: both stages end to end, resumed after every kind of interruption, faults told plainly."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import jax
import pytest

import scjax
from experiments import sample
from experiments.train import train
from scjax.scene.io import load_npz
from tests.factories.small_runs import get_config
from tests.factories.worlds import make_records

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    return make_records(tmp_path_factory.mktemp("world"), worlds=4)


@pytest.fixture(scope="module")
def undisturbed(records, tmp_path_factory):
    """Folder of an autoencoder run from start to end, its model of step 3 kept."""
    folder = tmp_path_factory.mktemp("undisturbed")
    config = get_config("autoencoder")
    config.records, config.export_at = str(records), (3,)
    train(config, folder)
    return folder


@pytest.fixture(scope="module")
def undisturbed_denoiser(undisturbed, records, tmp_path_factory):
    """Folder of a denoiser run from start to end."""
    folder = tmp_path_factory.mktemp("undisturbed_denoiser")
    config = get_config("denoiser")
    config.records, config.autoencoder = str(records), str(undisturbed / "model")
    train(config, folder)
    return folder


def start(workdir, records, *flags, stage="autoencoder", limit=None) -> subprocess.Popen:
    """``python -m experiments.train`` of the smallest stage in a process of its own."""
    config = f"tests/factories/small_runs.py:{stage}"
    command = [sys.executable, "-m", "experiments.train", f"--config={config}", f"--workdir={workdir}"]
    if limit:  # no file may grow beyond so many KiB
        command = ["bash", "-c", f'ulimit -f {limit}; exec "$@"', "-", *command]
    return subprocess.Popen(
        [*command, f"--config.records={records}", *flags], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def weights(folder: Path) -> bytes:
    return (folder / "model" / "weights.safetensors").read_bytes()


def wait_for(path: Path, process: subprocess.Popen, seconds: float = 240) -> None:
    end = time.monotonic() + seconds
    while not path.exists():
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < end, f"{path} did not appear"
        time.sleep(0.05)


def send(number: signal.Signals, once: Path) -> None:
    """A signal to this process as soon as ``once`` is there: the file of metrics is opened before the first step."""
    end = time.monotonic() + 240
    while not once.exists() and time.monotonic() < end:
        time.sleep(0.05)
    os.kill(os.getpid(), number)


def test_a_run_leaves_metrics_pictures_and_a_model(undisturbed):
    lines = [json.loads(line) for line in (undisturbed / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines if line["scope"] == "train"] == [3, 6, 9]
    assert {"loss", "gradient_norm", "scenes_per_second"} <= lines[0].keys()
    assert any(line["scope"] == "val" and line["lane_point_m"] > 0 for line in lines)
    assert list((undisturbed / "pictures").glob("*.png"))
    assert scjax.load(undisturbed / "model").autoencoder.params


def test_killed_at_any_moment_it_ends_bit_identical(undisturbed, undisturbed_denoiser, records, tmp_path, capsys):
    process = start(tmp_path, records, f"--config.autoencoder={undisturbed}/model", stage="denoiser")
    wait_for(tmp_path / "checkpoints" / "step_3", process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    config = get_config("denoiser")
    config.records, config.autoencoder = str(records), str(undisturbed / "model")
    train(config, tmp_path)
    assert "continuing" in capsys.readouterr().err
    assert weights(tmp_path) == weights(undisturbed_denoiser)


def test_after_a_full_disk_and_a_sigterm_the_same_command_continues(undisturbed, records, tmp_path, capsys):
    shutil.copytree(undisturbed, tmp_path, dirs_exist_ok=True)  # as it was after step 6
    for later in ("checkpoints/step_9", "model"):
        shutil.rmtree(tmp_path / later)
    full = start(tmp_path, records, limit=2)
    text = full.communicate()[0]
    assert full.returncode == 1, text
    # Before it, threads of orbax may print what they did not expect; the last line is ours.
    assert text.splitlines()[-1].startswith("experiments.train:") and str(tmp_path) in text.splitlines()[-1], text

    (tmp_path / "metrics.jsonl").unlink()  # whose return tells when to send the signal
    config = get_config("autoencoder")
    config.records = str(records)
    threading.Thread(target=lambda: send(signal.SIGTERM, tmp_path / "metrics.jsonl")).start()
    train(config, tmp_path)
    told = capsys.readouterr().err
    assert "at step 6" in told and "the same command continues" in told and not (tmp_path / "model").exists()
    train(config, tmp_path)
    assert weights(tmp_path) == weights(undisturbed)


def test_a_loss_that_is_not_finite_stops_the_run(undisturbed, records, tmp_path):
    config = get_config("autoencoder")
    model = scjax.load(undisturbed / "model")
    coder = model.autoencoder
    vast = jax.tree.map(lambda leaf: 1e30 * leaf, coder.params)
    config.records, config.start = str(records), str(tmp_path / "vast")
    scjax.save(model.with_component("autoencoder", coder.config, vast), config.start)
    with pytest.raises(FloatingPointError, match=r"loss of step \d+ is not finite.*(last good|no) checkpoint"):
        train(config, tmp_path / "run")


def test_another_model_in_the_same_folder_is_refused(undisturbed, records):
    config = get_config("autoencoder")
    config.records = str(records)
    config.model.lane_ff = 16
    with pytest.raises(ValueError, match=r"config\.model \(lane_ff differ\)"):
        train(config, undisturbed)


@pytest.mark.parametrize(
    ("flag", "message"),
    [
        ("--config.modl.lane_width=8", "model"),
        ("--config.steps=many", "steps"),
        ("--config.records=/nowhere", "manifest.json"),
        ("--config.batch.batch_size=0", "batch_size"),
    ],
)
def test_mistakes_on_the_command_line(records, tmp_path, flag, message):
    process = start(tmp_path, records, flag)
    text = process.communicate()[0]
    assert process.returncode != 0
    assert message in text and "Traceback" not in text, text
    assert not (tmp_path / "checkpoints").exists()


def test_denoiser_on_the_autoencoder_then_samples(undisturbed_denoiser, tmp_path):
    model = undisturbed_denoiser / "model"
    sample.main([f"--model={model}", f"--out={tmp_path}/samples", "-n", "2", "--steps", "3"])
    scenes = load_npz(tmp_path / "samples" / "scenes.npz")
    assert scenes.batch_shape == (2,)
    assert (tmp_path / "samples" / "scenes.png").stat().st_size > 10_000
    with pytest.raises(SystemExit, match="unknown"):
        sample.main([f"--model={model}", f"--out={tmp_path}/x", "--domain", "mars"])


def test_models_of_chosen_steps_are_kept(undisturbed):
    assert scjax.load(undisturbed / "model-3").notes["steps"] == 3
    assert scjax.load(undisturbed / "model").notes["steps"] == 9
