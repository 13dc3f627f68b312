"""Training as users run it: end to end, resumed after every kind of interruption, with plain errors.

What concerns the loop alone is stated for count predictors, since these compile fastest.
"""

import dataclasses
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
import jax.numpy as jnp
import pytest

import scjax
from scjax.data.manifest import load_manifest
from scjax.models.denoiser.config import TextCondition
from scjax.scene.files import LOCK_FILE, locked_folder
from scjax.train.launch import config_path, main, parse_arguments
from scjax.train.loop import train
from scjax.train.objectives.counts import CountObjective
from tests.factories.small_runs import get_config
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

# ml_collections loads config files by a method that Python 3.12 drops.
reads_config_files = pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning")
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def records(world_records):
    return world_records


@pytest.fixture(scope="module")
def undisturbed(records, tmp_path_factory):
    """Folder of an autoencoder run from start to end, its model of step 3 kept."""
    folder = tmp_path_factory.mktemp("undisturbed")
    config = get_config("autoencoder")
    config.records, config.export_at = str(records), (3,)
    train(config, folder)
    return folder


def counts_config(folder: Path):
    config = get_config("counts")
    config.records, config.denoiser = str(folder / "records"), str(folder / "text")
    return config


@pytest.fixture(scope="module")
def undisturbed_counts(captioned_records, tmp_path_factory):
    """Folder of a count predictor run from start to end; its records and text model are in the folder above."""
    folder = tmp_path_factory.mktemp("undisturbed_counts")
    (folder / "records").symlink_to(captioned_records)
    domains = tuple(load_manifest(captioned_records)["domains"])
    model = tiny_model(TextCondition(Words.width), domains=len(domains))
    scjax.save(dataclasses.replace(model, domains=domains, counts=None, text_encoder=Words.name), folder / "text")
    train(counts_config(folder), folder / "run")
    return folder / "run"


def start(workdir, records, *flags, limit=None) -> subprocess.Popen:
    """``python -m experiments.train`` of the smallest stage in a process of its own."""
    config = "tests/factories/small_runs.py:counts"
    command = [sys.executable, "-m", "experiments.train", f"--config={config}", f"--workdir={workdir}"]
    if limit:  # no file may grow beyond so many KiB
        command = ["bash", "-c", f'ulimit -f {limit}; exec "$@"', "-", *command]
    environment = {name: value for name, value in os.environ.items() if name != "GLIBC_TUNABLES"}  # as users start it
    return subprocess.Popen(
        [*command, f"--config.records={records}", *flags],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**environment, "PYTHONPATH": str(ROOT), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "1000"},
    )


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


def reported(folder: Path) -> list[int]:
    lines = map(json.loads, (folder / "metrics.jsonl").read_text().splitlines())
    return [line["step"] for line in lines if line["scope"] == "train"]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_train_writes_metrics_pictures_and_a_model(undisturbed):
    lines = [json.loads(line) for line in (undisturbed / "metrics.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines if line["scope"] == "train"] == [3, 6, 9]
    assert {"loss", "gradient_norm", "scenes_per_second"} <= lines[0].keys()
    assert any(line["scope"] == "val" and line["lane_point_m"] > 0 for line in lines)
    assert list((undisturbed / "pictures").glob("*.png"))
    assert scjax.load(undisturbed / "model").autoencoder.params


def test_train_resumes_bit_identical_after_sigkill(undisturbed_counts, tmp_path, capsys):
    config = counts_config(undisturbed_counts.parent)
    process = start(tmp_path, config.records, f"--config.denoiser={config.denoiser}")
    wait_for(tmp_path / "checkpoints" / "step_3", process)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 9, "scope": "train"}\n{"ste')  # case 21: as of a kill long after the checkpoint
    train(config, tmp_path)
    assert "continuing" in capsys.readouterr().err
    assert reported(tmp_path) == [3, 6, 9]
    assert weights(tmp_path) == weights(undisturbed_counts)


def test_train_continues_after_a_full_disk_and_sigterm(undisturbed_counts, tmp_path, capsys):
    shutil.copytree(undisturbed_counts, tmp_path, dirs_exist_ok=True)  # as it was after step 6
    for later in ("checkpoints/step_9", "model"):
        shutil.rmtree(tmp_path / later)
    config = counts_config(undisturbed_counts.parent)
    full = start(tmp_path, config.records, f"--config.denoiser={config.denoiser}", limit=8)
    text = full.communicate()[0]
    assert full.returncode == 1, text
    *reports, last = text.splitlines()  # threads of orbax print nothing
    assert all(line.startswith(("continuing ", "train step ", "val step ")) for line in reports), text
    assert last.startswith(f"experiments.train: the checkpoint of step 9 could not be written in {tmp_path}"), text
    assert last.endswith("(File too large): when that is mended, the same command continues from step 6"), text

    (tmp_path / "metrics.jsonl").unlink()  # whose return tells when to send the signal
    threading.Thread(target=lambda: send(signal.SIGTERM, tmp_path / "metrics.jsonl")).start()
    train(config, tmp_path)
    text = capsys.readouterr().err
    assert "at step 6" in text and "the same command continues" in text and not (tmp_path / "model").exists()
    train(config, tmp_path)
    assert weights(tmp_path) == weights(undisturbed_counts)


def test_train_stops_at_a_loss_that_is_not_finite(undisturbed_counts, tmp_path, monkeypatch):
    loss = CountObjective.loss

    def infinite(self, params, batch, keys):
        total, terms = loss(self, params, batch, keys)
        return total + jnp.inf, terms

    monkeypatch.setattr(CountObjective, "loss", infinite)
    with pytest.raises(FloatingPointError, match=r"loss of step \d+ is not finite; no checkpoint is before it"):
        train(counts_config(undisturbed_counts.parent), tmp_path)
    assert not list((tmp_path / "checkpoints").glob("step_*"))


def test_train_saves_nothing_of_an_update_that_is_not_finite(undisturbed_counts, tmp_path, monkeypatch):
    shutil.copytree(undisturbed_counts, tmp_path, dirs_exist_ok=True)  # as it was after step 6
    for later in ("checkpoints/step_9", "model"):
        shutil.rmtree(tmp_path / later)
    config = counts_config(undisturbed_counts.parent)
    config.export_at = (3, 6, 8)
    loss = CountObjective.loss

    def infinite_slope(self, params, batch, keys):
        """The loss is finite, its gradient is not from about step 8 on."""
        total, terms = loss(self, params, batch, keys)
        is_sound = (jnp.max(batch.index) < 14).astype(jnp.float32)
        return total + jnp.sqrt(is_sound + 0 * jax.tree.leaves(params)[0].sum()) - is_sound, terms

    with monkeypatch.context() as patch:
        patch.setattr(CountObjective, "loss", infinite_slope)
        with pytest.raises(FloatingPointError, match=r"gradient of step [789] is not .* good checkpoint is step 6"):
            train(config, tmp_path)
    assert sorted(path.name for path in (tmp_path / "checkpoints").glob("step_*")) == ["step_6"]
    assert (tmp_path / "model-6").exists() and not (tmp_path / "model").exists()
    train(config, tmp_path)
    assert weights(tmp_path) == weights(undisturbed_counts)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda config: config.model.update(lane_ff=16), r"config\.model\.lane_ff is 8 there and 16 here"),
        (lambda config: config.optimizer.update(weight_decay=0.5), r"config\.optimizer\.weight_decay"),
        (lambda config: config.update(steps=8), r"config\.steps is 9 there and 8 here, which is less"),
        (lambda config: config.update(seed=-1), "config: seed"),
    ],
)
def test_train_refuses_another_run_and_leaves_the_folder(undisturbed, records, change, message):
    """Case 26: a refused command writes nothing."""
    config, before = get_config("autoencoder"), contents(undisturbed)
    config.records = str(records)
    change(config)
    with pytest.raises(ValueError, match=message):
        train(config, undisturbed)
    assert contents(undisturbed) == before


def test_train_refuses_records_of_another_content(undisturbed, records, tmp_path):
    shutil.copytree(records, tmp_path / "records")
    config = get_config("autoencoder")
    config.records = str(tmp_path / "records")
    manifest = json.loads((tmp_path / "records" / "manifest.json").read_text())
    (tmp_path / "records" / "manifest.json").write_text(json.dumps({**manifest, "hash": "0" * 64}))
    with pytest.raises(ValueError, match=r"the content of config\.records is .* there, 00000000 here"):
        train(config, undisturbed)


def test_train_refuses_a_folder_in_use(records, tmp_path):
    config = get_config("autoencoder")
    config.records = str(records)
    with locked_folder(tmp_path), pytest.raises(ValueError, match="in use by another process"):
        train(config, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [LOCK_FILE]


@reads_config_files
def test_train_command_reports_an_unexpected_error_in_one_line(records, tmp_path, monkeypatch, capsys):
    def fails(_config, _workdir):
        raise KeyError("lanes")

    monkeypatch.setattr("scjax.train.loop.train", fails)
    arguments = ["--config=tests/factories/small_runs.py:autoencoder", f"--workdir={tmp_path}"]
    assert main(arguments, "scjax train") == 1
    assert capsys.readouterr().err == (
        "scjax train: unexpected KeyError: 'lanes'; run with --debug for the trace, please report it\n"
    )
    with pytest.raises(KeyError):
        main([*arguments, "--debug"], "scjax train")


@reads_config_files
def test_train_command_with_a_renamed_field_leaves_the_folder(tmp_path, capsys):
    """Case 26, as it was found."""
    (tmp_path / "config.json").write_text('{"the": "run of before"}')
    arguments = ["--config=denoiser:tiny", f"--workdir={tmp_path}", "--config.optimiser.kind=sgd"]
    assert main(arguments, "scjax train") == 2
    assert "config.optimizer.kind" in capsys.readouterr().err
    assert contents(tmp_path) == {str(tmp_path / "config.json"): b'{"the": "run of before"}'}


@reads_config_files
@pytest.mark.parametrize(
    ("flag", "message"),
    [
        ("--config.modl.lane_width=8", "model"),
        ("--config.steps=many", "steps"),
        ("--config.records=/nowhere", "manifest.json"),
        ("--config.batch.batch_size=0", "batch_size"),
        ("--config.batch.batch_size=1000000000000", "batch_size"),
        ("--config.optimizer.learning_rate=nan", "learning_rate"),
        ("--config.optimiser.kind=muon", "config.optimiser.kind is now called config.optimizer.kind"),
    ],
)
def test_train_command_rejects_mistakes(records, tmp_path, flag, message, capsys):
    config = "--config=tests/factories/small_runs.py:autoencoder"
    code = main([config, f"--workdir={tmp_path}", f"--config.records={records}", flag], "scjax train")
    text = capsys.readouterr().err
    assert code in (1, 2) and text.startswith("scjax train: ")
    assert message in text and text.count("\n") == 1, text
    assert not (tmp_path / "checkpoints").exists()


@reads_config_files
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--workdir=x"], "give --config"),
        (["--config=denoiser:tiny"], "give --workdir"),
        (["--config=denoyser", "--workdir=x"], "choose autoencoder, behavior, counts, denoiser"),
        (["--config=denoiser:huge", "--workdir=x"], "--config=denoiser:huge is an unknown variant"),
        (["--config=denoiser", "--workdir=x", "extra"], "unknown argument 'extra'"),
        (["--config=denoiser", "--workdir=x", "--config.optimzer.kind=muon"], 'Did you mean "optimizer"'),
    ],
)
def test_train_command_names_wrong_usage(arguments, message, capsys):
    assert main(arguments, "scjax train") == 2
    text = capsys.readouterr().err
    assert text.startswith("scjax train: ") and message in text and text.count("\n") == 1


@reads_config_files
@pytest.mark.parametrize("name", ["autoencoder", "denoiser", "counts", "counter"])
@pytest.mark.parametrize("form", ["{}:tiny", "experiments/configs/{}.py:tiny"])
def test_parse_arguments_finds_packaged_configs_and_files(name, form, monkeypatch):
    monkeypatch.chdir(ROOT)
    config, workdir, distributed = parse_arguments(
        [f"--config={form.format(name)}", "--workdir=runs/x", "--config.batch.batch_size=3"], "scjax train"
    )
    assert config.objective == ("counts" if name == "counter" else name)
    assert (config.batch.batch_size, workdir, distributed) == (3, Path("runs/x"), None)


def test_config_path_keeps_the_variant():
    assert config_path("denoiser:small").endswith("scjax/train/configs/denoiser.py:small")


def test_train_exports_models_of_chosen_steps(undisturbed):
    assert scjax.load(undisturbed / "model-3").notes["steps"] == 3
    assert scjax.load(undisturbed / "model").notes["steps"] == 9
