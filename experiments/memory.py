"""Memory that a process frees stays with it: XLA on a CPU asks for its working memory anew in every step.

glibc gives large blocks back to the kernel, which hands them out again a page of 4 KB at a time, zeroed: up to a fifth
of a training step (benchmarks/README.md). Kept, and in huge pages, it costs that once. That can be had in the heaps of
all threads by nothing but the environment that a process starts with. A single heap could be set up later, but what
compilers leave in it slows every later allocation, and with it trainings, down to half their speed.
"""

from __future__ import annotations

import os
import platform
import sys

_NAME = "GLIBC_TUNABLES"
_TUNABLES = {
    "mmap_max": 0,  # no block is a mapping of its own, which goes when it is freed
    "trim_threshold": 1 << 60,  # bytes free at a heap's end before they are given back
    # Bytes by which a heap grows at least. It is all that a thread's heap holds, so that one is never given back; what
    # is larger still goes when it is freed, unless the main thread has it, and comes in huge pages.
    "top_pad": 64 << 20,
    "hugetlb": 1,  # huge pages
}
_SETTING = ":".join(f"glibc.malloc.{name}={value}" for name, value in _TUNABLES.items())


def keep_memory() -> bool:
    """Starts this process anew, unless it was, so that it keeps what it frees.

    For the top of a ``__main__``, before anything is read or written, or imported that takes time. The process then
    holds the most that it ever used, and no more; processes that it starts do not.

    Returns:
      Whether it keeps. Only glibc can; and where the user has set GLIBC_TUNABLES, to whatever, that is left alone.
    """
    if platform.libc_ver()[0] != "glibc" or not sys.executable:
        return False
    found = os.environ.get(_NAME)
    if found is None:
        sys.stdout.flush()
        sys.stderr.flush()
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**os.environ, _NAME: _SETTING})
    if found != _SETTING:
        return False
    del os.environ[_NAME]
    return True
