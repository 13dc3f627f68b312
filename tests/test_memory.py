"""Freed memory stays with the process; in a process of its own, since it is for good."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from scjax import memory

FAULTS = """
import resource, sys
import numpy as np
from scjax.memory import keep_memory

if sys.argv[1] == "keep":
    assert keep_memory()
before = 0
for _ in range(3):  # the first round may ask the kernel; of the last one the faults are told
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    block = np.empty(48 << 20, np.uint8)
    block[::4096] = 1
    del block
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can keep memory")
def test_a_block_that_was_freed_is_not_asked_for_again():
    def faults(how: str) -> int:
        done = subprocess.run([sys.executable, "-c", FAULTS, how], capture_output=True, text=True, check=True)
        return int(done.stdout)

    assert faults("keep") == 0
    assert faults("plain") > 10  # with small pages 12,288, with huge ones 24


def test_without_glibc_nothing_happens(monkeypatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert not memory.keep_memory()
