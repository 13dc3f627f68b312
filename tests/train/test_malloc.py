"""Freed memory stays with the process; in a process of its own, since it starts that anew."""

from __future__ import annotations

import os
import pathlib
import platform
import subprocess
import sys

import pytest

from scjax.train import malloc as memory

needs_glibc = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can keep memory")

FAULTS = """
import concurrent.futures, pathlib, resource, sys
import numpy as np
from scjax.train import malloc as memory

if sys.argv[1] == "64 MB":
    memory._GIGANTIC = pathlib.Path("/none")  # as where Linux knows no pages of 1 GB
if sys.argv[1] != "plain":
    assert memory.keep_memory()

def faults(size):
    before = 0
    for _ in range(3):  # the first round may ask the kernel; of the last one the faults are told
        before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
        block = np.empty(size, np.uint8)
        block[::4096] = 1
        del block
    return resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before

# Without the setting, glibc maps what is above 32 MB for itself; with it, another thread's heap holds 64 MB or 4 GB.
with concurrent.futures.ThreadPoolExecutor(1) as other:
    print(faults(80 << 20), other.submit(faults, 40 << 20).result(), other.submit(faults, 80 << 20).result())
"""

TOLD = """
import os, subprocess, sys
from scjax.train.malloc import keep_memory
print(keep_memory(), sys.argv[1:], sys.stdin.read(), flush=True)
subprocess.run([sys.executable, "-c", "import os; print(os.environ.get('GLIBC_TUNABLES'))"])
"""


def run(code: str, *arguments: str, tunables: str | None = None) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "GLIBC_TUNABLES"}
    if tunables is not None:
        environment["GLIBC_TUNABLES"] = tunables
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, input="told", capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return done.stdout


@needs_glibc
@pytest.mark.parametrize("heaps", ["4 GB", "64 MB"])
def test_blocks_that_were_freed_are_not_asked_for_again(heaps):
    """In a heap of another thread neither, but for what it does not hold, which comes in huge pages if any."""
    main, other, beyond = map(int, run(FAULTS, heaps).split())
    assert main == other == 0
    huge = pathlib.Path("/sys/kernel/mm/transparent_hugepage/enabled")
    if heaps == "4 GB" and memory._GIGANTIC.exists():
        assert beyond == 0
    elif huge.exists() and "[never]" not in huge.read_text():
        assert beyond <= 41  # 40 pages of 2 MB, and one that is cut


@needs_glibc
def test_they_are_asked_for_again_without_it():
    assert all(int(faults) > 10 for faults in run(FAULTS, "plain").split())  # NumPy asks for huge pages itself


@needs_glibc
def test_it_is_the_same_command_and_what_it_starts_is_as_ever():
    assert run(TOLD, "--steps", "a b").split("\n")[:2] == ["True ['--steps', 'a b'] told", "None"]


def test_the_tunables_of_a_user_are_left_alone():
    assert run(TOLD, tunables="").split("\n")[0] == "False [] told"


def test_without_glibc_nothing_happens(monkeypatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not memory.keep_memory()
