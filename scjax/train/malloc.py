"""Memory that a process frees stays with it: XLA on a CPU asks for its working memory anew in every step.

glibc gives large blocks back to the kernel, which hands them out again a page of 4 KB at a time, zeroed: up to a third
of a training step (benchmarks/README.md). Kept, it costs that once. In the heaps of all threads that can be had by
nothing but the environment that a process starts with. A single heap could be set up later, but what compilers leave in
it slows every later allocation, and with it trainings, down to half their speed.
"""

from __future__ import annotations

import os
import pathlib
import platform
import sys

_NAME = "GLIBC_TUNABLES"
_GIGANTIC = pathlib.Path("/sys/kernel/mm/hugepages/hugepages-1048576kB")


def _setting() -> str:
    """What glibc is told.

    A thread's heap has 64 MB, and a larger block, such as XLA's working memory, comes and goes as it did. Where Linux
    knows pages of 1 GB, to ask for them makes heaps of four pages each, in pages of 4 KB unless someone has set some
    such pages aside. (In huge pages as well, trials were up to a tenth faster, but no tunable has both.)
    """
    gigantic = _GIGANTIC.exists()
    tunables = {
        "mmap_max": 0,  # no block is a mapping of its own, which goes when it is freed
        "trim_threshold": 1 << 60,  # bytes free at a heap's end before they are given back
        "top_pad": (256 if gigantic else 64) << 20,  # bytes by which a heap grows at least, of these all that it holds
        "hugetlb": 1 << 30 if gigantic else 1,  # 1: pages of 2 MB wherever they fit
    }
    return ":".join(f"glibc.malloc.{name}={value}" for name, value in tunables.items())


def keep_memory() -> bool:
    """Starts this process anew, unless it was, so that it keeps what it frees.

    For the top of a ``__main__``, before anything is read or written, or imported that takes time. The process then
    holds the most that it ever used, and no more; processes that it starts do not.

    Returns:
      Whether it keeps. Only glibc can; and where the user has set GLIBC_TUNABLES, to whatever, that is left alone.
    """
    if platform.libc_ver()[0] != "glibc" or not sys.executable:
        return False
    found, setting = os.environ.get(_NAME), _setting()
    if found is None:
        sys.stdout.flush()
        sys.stderr.flush()
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**os.environ, _NAME: setting})
    if found != setting:
        return False
    del os.environ[_NAME]
    return True
