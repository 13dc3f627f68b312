"""``scjax evaluate`` and ``python -m experiments.evaluate``: configs, overrides, errors in one line."""

import runpy
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from scjax.cli.config_flags import load_config
from scjax.cli.evaluate import evaluate
from scjax.evaluate.config import get_config
from tests.factories.evaluations import save_worlds

ROOT = Path(__file__).resolve().parents[2]


def test_load_config_sets_fields_of_every_type():
    config = load_config(
        "mechanisms",
        get_config,
        (
            "--config.seed=3",
            "--config.guidance",
            "2",
            "--config.compat=false",
            "--config.folders.global=runs/x",
            "--config.gains=(('a', 'b'),)",
            "--config.more=name=a, source=npz:x",
        ),
    )
    assert (config.seed, config.guidance, config.compat) == (3, 2.0, False)
    assert config.folders["global"] == "runs/x" and config.gains == (("a", "b"),)
    assert config.more == "name=a, source=npz:x"


def test_load_config_reads_a_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        "from scjax.evaluate.config import get_config as base\n\n"
        "def get_config(variant='standard'):\n    config = base(variant)\n    config.title = 'Mine'\n    "
        "return config\n"
    )
    assert load_config(f"{path}:baselines", get_config).title == "Mine"
    assert load_config(str(path), get_config).novelty == 150


@pytest.mark.parametrize(
    ("text", "overrides", "message"),
    [
        ("huge", (), "unknown variant 'huge'"),
        ("nowhere.py", (), "nowhere.py: there is no such file"),
        ("standard", ("--config.guidnace=2",), r"--config.guidnace: there is no such field; do you mean guidance\?"),
        ("standard", ("--config.seed=x",), "--config.seed=x: expected a value of type int, as 0"),
        ("standard", ("--config.compat=maybe",), "expected a value of type bool"),
        ("standard", ("--config.shard=(1",), "expected a value of type tuple"),
        ("standard", ("seed=1",), "unexpected argument 'seed=1': change fields with --config.FIELD=VALUE"),
    ],
)
def test_load_config_names_mistakes(text, overrides, message):
    with pytest.raises(ValueError, match=message):
        load_config(text, get_config, overrides)


def test_evaluate_command_writes_a_report(tmp_path):
    worlds = save_worlds(tmp_path / "worlds")
    arguments = [
        "--config=baselines",
        f"--workdir={tmp_path / 'out'}",
        f"--config.reference=npz:{worlds}",
        f"--config.retrieval_set=npz:{worlds}",
        "--config.methods=('copy',)",
        "--config.workers=0",
        "--config.bootstrap=2",
        "--config.gallery=1",
        "--config.side_by_side=1",
    ]
    result = CliRunner().invoke(evaluate, arguments, catch_exceptions=False)
    assert result.exit_code == 0 and f"report: {tmp_path / 'out' / 'report.html'}" in result.output
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning")  # ml_collections loads config files by it
def test_experiments_evaluate_reports_errors_in_one_line(tmp_path, monkeypatch, capsys):
    config = ROOT / "experiments/configs/evaluate.py"
    words = [f"--config={config}:baselines", f"--workdir={tmp_path / 'out'}", "--config.reference=npz:nowhere"]
    monkeypatch.setattr("scjax.nn.startup.start_jax", lambda: None)  # it has started
    monkeypatch.setattr(sys, "argv", ["experiments.evaluate", *words])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("experiments.evaluate", run_name="__main__")
    error = capsys.readouterr().err
    assert stop.value.code == 1 and "Traceback" not in error
    assert "scjax: npz:nowhere: there is no .npz file" in error
