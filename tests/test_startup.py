"""What starting costs, without a clock: the packages that a new process has imported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator

import click
import pytest

from scjax.cli import cli

SELDOM_USED = {"grain", "matplotlib", "ml_collections", "orbax", "scipy", "tensorstore", "tokenizers"}
HEAVY = SELDOM_USED | {"flax", "jax", "numpy", "optax", "rich", "treescope"}
NAME_TABLES = {("simulate",), ("outpaint",), ("demo",), ("edit",), ("generate",), ("place",), ("export",)}
"""Commands whose help names samplers and their steps, or formats, which stand beside their code."""


def _imported_packages(code: str) -> set[str]:
    """Top-level packages that a new process has imported when it ends."""
    report = "print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr)"
    program = f"import sys\n{code}\n{report}"
    process = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    return set(process.stderr.split())


def _commands(command: click.Command, *words: str) -> Iterator[tuple[str, ...]]:
    yield words
    if isinstance(command, click.Group):
        for name, subcommand in command.commands.items():
            yield from _commands(subcommand, *words, name)


COMMANDS = list(_commands(cli))
HELP = """
import json, sys

def packages():
    return {name.partition(".")[0] for name in sys.modules}

from scjax.cli import main
before, imported = set(), {}
for words in json.loads(sys.argv[1]):
    try:
        main([*words, "--help"])
    except SystemExit as end:
        assert not end.code
    imported[" ".join(words)] = sorted(packages() - before)
    before = packages()
print(json.dumps([sorted(before), imported]), file=sys.stderr)
"""


@pytest.fixture(scope="module")
def help_imports():
    """All packages of a process that shows the help of all commands, and those that each of them adds.

    The first one adds those of the start. Commands whose help needs JAX come last.
    """
    words = json.dumps(sorted(COMMANDS, key=lambda words: words in NAME_TABLES))
    process = subprocess.run([sys.executable, "-c", HELP, words], check=True, capture_output=True, text=True)
    return json.loads(process.stderr)


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(("scjax", *words)))
def test_help_imports_no_heavy_package(words, help_imports):
    packages, imported = help_imports
    assert "scjax" in packages
    assert not set(imported[" ".join(words)]) & (SELDOM_USED if words in NAME_TABLES else HEAVY)


def test_import_of_scjax_imports_no_heavy_package():
    packages = _imported_packages("import scjax")
    assert "scjax" in packages
    assert not packages & HEAVY


def test_public_names_import_no_seldom_used_package():
    packages = _imported_packages("import scjax; [getattr(scjax, name) for name in scjax.__all__ if name != 'viz']")
    assert "jax" in packages
    assert not packages & SELDOM_USED


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="does not tell the number of cores")
def test_reading_training_configs_leaves_the_choice_of_devices_open():
    """A backend that starts too early would see one device, and the training would run on one core."""
    code = (
        "import os, sys, jax\n"
        "from scjax.nn.sharding import use_every_core\n"
        "from scjax.train.configs import autoencoder, counts, denoiser\n"
        "[config.get_config() for config in (autoencoder, counts, denoiser)]\n"
        "use_every_core()\n"
        "sys.exit(jax.local_device_count() != len(os.sched_getaffinity(0)))"
    )
    environment = {name: value for name, value in os.environ.items() if name != "JAX_NUM_CPU_DEVICES"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment | {"JAX_PLATFORMS": "cpu"})
