"""What starting costs, without a clock: the packages that a new process has imported."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import click
import pytest

from scjax.cli import cli

SELDOM_USED = {"grain", "matplotlib", "ml_collections", "orbax", "scipy", "tensorstore", "tokenizers"}
HEAVY = SELDOM_USED | {"flax", "jax", "numpy", "optax", "rich", "treescope"}
NAME_SAMPLERS = {("demo",), ("generate",)}
"""Commands whose help names samplers and their steps, which stand beside their code."""


def _imported_packages(code: str) -> set[str]:
    """Top-level packages that a new process has imported when it ends."""
    report = "print(*{name.partition('.')[0] for name in sys.modules}, file=sys.stderr)"
    program = f"import sys\ntry:\n    {code}\nfinally:\n    {report}"
    process = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    return set(process.stderr.split())


def _commands(command: click.Command, *words: str) -> Iterator[tuple[str, ...]]:
    yield words
    if isinstance(command, click.Group):
        for name, subcommand in command.commands.items():
            yield from _commands(subcommand, *words, name)


@pytest.mark.parametrize("words", list(_commands(cli)), ids=lambda words: " ".join(("scjax", *words)))
def test_help_imports_no_heavy_package(words):
    packages = _imported_packages(f"from scjax.cli import main; main({[*words, '--help']})")
    assert "scjax" in packages
    assert not packages & (SELDOM_USED if words in NAME_SAMPLERS else HEAVY)


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
