"""Freed memory stays with the process; in a process of its own, since it starts that anew."""

from __future__ import annotations

import os
import pathlib
import platform
import subprocess
import sys

import pytest

from scjax.train import malloc

needs_glibc = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can keep memory")


def _asks_for_huge_pages() -> bool:
    mode = pathlib.Path("/sys/kernel/mm/transparent_hugepage/enabled")
    return mode.exists() and "[madvise]" in mode.read_text()


FAULTS = """
import concurrent.futures, pathlib, resource, sys
import numpy as np
from scjax.train import malloc

if sys.argv[1] == "64 MB":
    assert malloc.keep_memory(gigantic=False)  # as where Linux has no pages of 1 GB
elif sys.argv[1] != "plain":
    assert malloc.keep_memory()

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

HUGE_PAGES = """
import concurrent.futures, ctypes, pathlib, re, sys
from scjax.train import malloc

if sys.argv[1] == "kept":
    assert malloc.keep_memory(gigantic=False)
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p

def are_requested(size):  # by what Linux says of the mapping that the block is in
    place, inside = libc.malloc(ctypes.c_size_t(size)) + size // 2, False
    for line in pathlib.Path("/proc/self/smaps").read_text().splitlines():
        if bounds := re.match("([0-9a-f]+)-([0-9a-f]+) ", line):
            inside = int(bounds[1], 16) <= place < int(bounds[2], 16)
        elif inside and line.startswith("VmFlags:"):
            return "hg" in line.split()

with concurrent.futures.ThreadPoolExecutor(1) as other:
    print(are_requested(80 << 20), *(other.submit(are_requested, size << 20).result() for size in (40, 80)))
"""

REPORT = """
import os, subprocess, sys
from scjax.train.malloc import keep_memory
print(keep_memory(), sys.argv[1:], sys.stdin.read(), flush=True)
subprocess.run([sys.executable, "-c", "import os; print(os.environ.get('GLIBC_TUNABLES'))"])
"""


HELD = """
import re, sys
from scjax.train.malloc import give_back_memory, keep_memory

def held():
    with open("/proc/self/status") as status:
        return int(re.search(r"VmRSS:\\s+(\\d+)", status.read())[1]) / 1e3

assert keep_memory(gigantic=False)
block = bytearray(256_000_000)
block[::4096] = b"1" * len(block[::4096])
full = held()
del block
kept = held()
give_back_memory()
print(full, kept, held())
"""


def run(code: str, *arguments: str, tunables: str | None = None) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "GLIBC_TUNABLES"}
    if tunables is not None:
        environment["GLIBC_TUNABLES"] = tunables
    process = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=environment,
        input="stdin",
        capture_output=True,
        text=True,
        check=True,
    )
    return process.stdout


@needs_glibc
@pytest.mark.parametrize("heaps", ["4 GB", "64 MB"])
def test_keep_memory_reuses_freed_blocks(heaps):
    """In a heap of another thread too, but for what it does not hold."""
    main, other, beyond = map(int, run(FAULTS, heaps).split())
    assert main == other == 0
    assert beyond == 0 or heaps == "64 MB" or not malloc._GIGANTIC.exists()


@needs_glibc
@pytest.mark.skipif(not _asks_for_huge_pages(), reason="glibc asks for huge pages only where Linux waits for that")
def test_keep_memory_asks_for_huge_pages_in_all_heaps():
    """What a heap does not hold comes anew, but in huge pages if Linux has any free."""
    assert run(HUGE_PAGES, "kept").split() == ["True"] * 3
    assert run(HUGE_PAGES, "plain").split() == ["False"] * 3


@needs_glibc
def test_without_keep_memory_freed_blocks_are_given_back():
    assert all(int(faults) > 10 for faults in run(FAULTS, "plain").split())  # NumPy asks for huge pages itself


@needs_glibc
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_give_back_memory_gives_back_what_is_kept():
    full, kept, after = map(float, run(HELD).split())
    assert kept > full - 50 and after < full - 200  # MB of 256


@needs_glibc
def test_keep_memory_runs_the_same_command():
    assert run(REPORT, "--steps", "a b").split("\n")[:2] == ["True ['--steps', 'a b'] stdin", "None"]


def test_keep_memory_leaves_tunables_of_the_user():
    assert run(REPORT, tunables="").split("\n")[0] == "False [] stdin"


def test_keep_memory_does_nothing_without_glibc(monkeypatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not malloc.keep_memory()


@needs_glibc
@pytest.mark.parametrize(
    ("arguments", "environment", "kept"),
    [([], None, True), (["--no-keep-memory"], None, False), ([], "0", False), (["--keep-memory"], "0", True)],
)
def test_keep_memory_is_an_option(arguments, environment, kept, monkeypatch):
    monkeypatch.setattr(malloc, "keep_memory", lambda: True)
    monkeypatch.delenv("SCJAX_KEEP_MEMORY", raising=False)
    if environment is not None:
        monkeypatch.setenv("SCJAX_KEEP_MEMORY", environment)
    assert malloc.keep_memory_by_option(["--workdir=x", *arguments]) == kept
    assert malloc.without_memory_option(["--workdir=x", *arguments]) == ["--workdir=x"]
