"""Several processes train what one process trains."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scjax.train.launch import parse_arguments
from tests.factories.process_steps import run_process_steps

ROOT = Path(__file__).resolve().parents[2]
reads_config_files = pytest.mark.filterwarnings("ignore:the load_module:DeprecationWarning")
ADDRESS = ("--coordinator_address=host:1", "--num_processes=2", "--process_id=1")


def _free_address() -> str:
    with socket.socket() as opened:
        opened.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{opened.getsockname()[1]}"


def test_two_processes_take_the_steps_of_one(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_NUM_CPU_DEVICES": "1"}
    address = _free_address()
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "tests.factories.process_steps", address, "2", str(i), str(tmp_path / f"{i}.json")],
            cwd=ROOT,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for i in range(2)
    ]
    outputs = [process.communicate(timeout=600)[0] for process in started]
    assert [process.returncode for process in started] == [0, 0], outputs
    first, second = (json.loads((tmp_path / f"{i}.json").read_text()) for i in range(2))
    assert first == second
    for sharding, results in first.items():
        for name, values in run_process_steps(sharding).items():
            np.testing.assert_allclose(results[name], values, rtol=1e-5, atol=1e-7)


@reads_config_files
def test_parse_arguments_reads_the_place_among_processes():
    arguments = ["--config=counts:tiny", "--workdir=x"]
    expected = {"coordinator_address": "host:1", "num_processes": 2, "process_id": 1}
    assert parse_arguments([*arguments, *ADDRESS], "scjax train")[2] == expected
    assert parse_arguments([*arguments, "--distributed"], "scjax train")[2] == {}


@reads_config_files
def test_parse_arguments_rejects_half_a_place():
    with pytest.raises(ValueError, match="give --coordinator_address, --num_processes, --process_id together"):
        parse_arguments(["--config=counts:tiny", "--workdir=x", *ADDRESS[:2]], "scjax train")
