"""Launcher option: a training process keeps the memory that it frees, for its next step.

XLA on a CPU allocates its working memory anew in every step. glibc gives freed blocks back to the kernel, which hands
them out again by pages of 4 KB, zeroed: up to a third of a training step (benchmarks/README.md). Kept memory costs that
once. For the heaps of all threads, only the environment that a process starts with can set this, so the launcher starts
the process again. (A single heap could be set up later, but what compilers leave in it slows every later allocation:
trainings ran at down to half their speed.)

``--keep-memory`` (the default) and ``--no-keep-memory`` choose; SCJAX_KEEP_MEMORY=0 changes the default.
"""

from __future__ import annotations

import ctypes
import os
import pathlib
import platform
import sys
from collections.abc import Sequence

ON, OFF = "--keep-memory", "--no-keep-memory"

_NAME = "GLIBC_TUNABLES"
_GIGANTIC = pathlib.Path("/sys/kernel/mm/hugepages/hugepages-1048576kB")


def keep_memory_by_option(arguments: Sequence[str]) -> bool:
    """``keep_memory`` unless the arguments or SCJAX_KEEP_MEMORY=0 say otherwise; the last option counts."""
    options = [argument for argument in arguments if argument in (ON, OFF)]
    default = OFF if os.environ.get("SCJAX_KEEP_MEMORY") == "0" else ON
    return keep_memory() if (options[-1] if options else default) == ON else False


def without_memory_option(arguments: Sequence[str]) -> list[str]:
    """The arguments without ``--keep-memory`` and ``--no-keep-memory``."""
    return [argument for argument in arguments if argument not in (ON, OFF)]


def keep_memory(gigantic: bool = _GIGANTIC.exists()) -> bool:
    """Starts this process again, unless it was already, with glibc set to keep what it frees.

    For the start of a command, before it reads, writes, or imports what takes time. The process then holds the most
    memory that it ever used. Processes that it starts do not inherit the setting.

    Args:
      gigantic: whether Linux has pages of 1 GB.

    Returns:
      Whether memory is kept. Only glibc can, and a GLIBC_TUNABLES that the user set stays as it is.
    """
    if platform.libc_ver()[0] != "glibc" or not sys.executable:
        return False
    current, setting = os.environ.get(_NAME), _tunables(gigantic)
    if current is None:
        sys.stdout.flush()
        sys.stderr.flush()
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**os.environ, _NAME: setting})
    if current != setting:
        return False
    del os.environ[_NAME]
    return True


def give_back_memory() -> None:
    """Gives freed memory back to the kernel, also where it is kept; without effect where glibc is not used."""
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).malloc_trim(0)


def _tunables(gigantic: bool) -> str:
    """The value of GLIBC_TUNABLES.

    The heap of a thread has 64 MB; a larger block, such as XLA's working memory, is still given back. With pages of
    1 GB, heaps have four such pages, made of pages of 4 KB unless someone reserved large ones. (Huge pages as well
    were up to a tenth faster in trials, but no tunable has both.)
    """
    tunables = {
        "mmap_max": 0,  # no block is a mapping of its own, which is given back when it is freed
        "trim_threshold": 1 << 60,  # free bytes at a heap's end before they are given back
        "top_pad": (256 if gigantic else 64) << 20,  # least number of bytes by which a heap grows
        "hugetlb": 1 << 30 if gigantic else 1,  # 1: pages of 2 MB wherever they fit
    }
    return ":".join(f"glibc.malloc.{name}={value}" for name, value in tunables.items())
