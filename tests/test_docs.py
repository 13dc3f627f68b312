"""Every snippet of the README and of docs/ runs.

Python snippets run as they are, one page after the other in an empty folder, with the model of the package. Commands of
``scjax`` run with smaller numbers (``SMALLER``); those that train or evaluate for long are parsed down to their config,
since the same entry points train and evaluate elsewhere in the tests.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from experiments.reproduce import commands, head_commands
from scjax.cli import cli, main
from scjax.cli.config_flags import load_config
from scjax.evaluate.config import get_config
from scjax.train.launch import parse_arguments
from tests.factories.few_programs import use_few_programs
from tests.factories.map_files import write_map_files
from tests.factories.scene_files import write_scene_file

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
RESULTS = [page for page in sorted((ROOT / "docs/results").glob("*.md")) if page.stem != "README"]
CARDS = [*sorted((ROOT / "scjax").glob("*/README.md")), ROOT / "benchmarks/README.md", ROOT / "CONTRIBUTING.md"]
SMALLER = {
    "--worlds 2000": "--worlds 1",
    "--worlds 8": "--worlds 1",
    "--worlds 1800": "--worlds 1",
    " --gif": "",
    "-n 20": "-n 5",
    " --seed 4": " --seed 4 --seconds 1.5",
    " -n 4": " -n 1 --best-of 1",
}
WITH_WORKERS = ("build", "synthetic", "caption", "attributes", "logs", "dashcam")  # none here: they take long to start
NOT_RUN = ("pip install", "scjax demo")  # the two commands of the README: .ci/run runs them


def _snippets(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def _commands(page: Path) -> list[str]:
    lines = "".join(_snippets(page, "bash")).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.startswith(NOT_RUN)]


def _run(command: str) -> int:
    """Exit status of a command of ``scjax`` in this process."""
    for text, smaller in SMALLER.items():
        command = command.replace(text, smaller)
    with pytest.raises(SystemExit) as exit_info:
        main(shlex.split(command)[1:])
    return int(exit_info.value.code or 0)


@pytest.fixture(autouse=True)
def few_programs(monkeypatch):
    """Scenes of all pages have one shape."""
    use_few_programs(monkeypatch)


@pytest.mark.parametrize("page", [page for page in PAGES if _snippets(page, "python")], ids=lambda page: page.stem)
def test_python_snippets_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene_file(tmp_path / "recordings")
    write_map_files(tmp_path)
    names = {"__name__": f"docs_{page.stem}"}
    for snippet in _snippets(page, "python"):
        exec(compile(snippet, str(page), "exec"), names)


def test_readme_commands_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert {_run(command) for command in _commands(ROOT / "README.md")} == {0}
    assert len(list(tmp_path.rglob("*.png"))) == 1


def test_data_commands_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene_file(tmp_path / "recordings")
    commands = [command for command in _commands(ROOT / "docs/train.md") if command.startswith("scjax data")]
    without_encoder = [command for command in commands if " embed " not in command]
    assert len(without_encoder) == len(commands) - 1
    alone = [f"{command} --workers 0" if command.split()[2] in WITH_WORKERS else command for command in without_encoder]
    assert {_run(command) for command in alone} == {0}


@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning")  # ml_collections loads config files by it
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_training_commands_have_valid_configs(page):
    for command in _commands(page):
        if command.startswith("scjax train"):
            config, _, _ = parse_arguments(shlex.split(command)[2:], "scjax train")
            assert config.steps > 0


def test_evaluation_commands_have_valid_configs():
    commands = [shlex.split(command) for command in _commands(ROOT / "docs/evaluate.md")]
    assert commands
    for _, name, config, workdir, *overrides in commands:
        assert name == "evaluate" and workdir.startswith("--workdir=")
        assert load_config(config.removeprefix("--config="), get_config, overrides).methods


def _flags_of_module(name: str) -> set[str] | None:
    """Flags that ``python -m NAME`` may take: words of its folder that begin with two dashes; None: no such module."""
    path = ROOT / name.replace(".", "/")
    files = sorted(path.glob("*.py")) if (path / "__main__.py").is_file() else [path.with_suffix(".py")]
    if not files[0].is_file():
        return None
    text = "".join(file.read_text(encoding="utf-8") for file in (*files, ROOT / "experiments/studies/page.py"))
    return {*re.findall('"(--?[a-z][a-z-]*)"', text), "--help"}


def _flags_of_command(words: list[str]) -> set[str] | None:
    """Flags that a command of ``scjax`` takes; None: no such command."""
    command: click.Command = cli
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        if words[0] not in command.commands:
            return None
        command = command.commands[words.pop(0)]
    return {flag for option in command.params for flag in (*option.opts, *option.secondary_opts)} | {
        "--help",
        "--debug",
    }


def _fault(command: str) -> str | None:
    """What of a command on a page does not exist."""
    words = shlex.split(command)
    if words[0] in ("bash", "nice"):
        words = words[1 if words[0] == "bash" else words.index("python") :]
    if "/" in words[0]:
        return None if (ROOT / words[0]).is_file() else command
    if words[:2] == ["python", "-m"]:
        words = words[2:]
    if words[0] in ("python", "pytest"):
        return None
    if words[:2] == ["scjax", "train"] and len(words) > 2:
        return None if parse_arguments([*words[2:], "--workdir=runs"], "scjax train") else command
    named = {word.partition("=")[0] for word in words if re.match("--?[a-z]", word)}
    if "--config" in named:
        config, *fields = (word for word in words if word.startswith("--config"))
        load_config(config.removeprefix("--config="), get_config, fields)
        named = {name for name in named if not name.startswith(("--config", "--workdir"))}
    flags = _flags_of_command(words[1:]) if words[0] == "scjax" else _flags_of_module(words[0])
    return command if flags is None or not named <= flags else None


@pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning")
@pytest.mark.parametrize("page", [*PAGES, *RESULTS, *CARDS], ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_on_pages_exist_with_their_flags(page):
    assert not [fault for command in commands(page.read_text(encoding="utf-8")) if (fault := _fault(command))]


@pytest.mark.parametrize("page", RESULTS, ids=lambda page: page.stem)
def test_results_say_command_and_commit(page):
    text = page.read_text(encoding="utf-8")
    assert head_commands(text) and re.search(r"\bcommit [0-9a-f]{7}\b", text)


def test_links_lead_to_files():
    broken = [
        f"{page.relative_to(ROOT)}: {target}"
        for page in [
            *PAGES,
            *(ROOT / "docs/results").glob("*.md"),
            ROOT / "CONTRIBUTING.md",
            ROOT / "benchmarks/README.md",
        ]
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert not broken


def test_results_are_light_and_reproducible():
    files = [path for path in (ROOT / "docs/results").rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= 1.5e6
    assert not [path.name for path in files if path.suffix == ".md" and "not kept" in path.read_text(encoding="utf-8")]
