"""Memory that a process frees stays with it: XLA on a CPU asks for its working memory anew in every step.

glibc gives large blocks back to the kernel, which hands them out again a page of 4 KB at a time, zeroed: up to a fifth
of a training step (benchmarks/README.md). Kept, and in huge pages, it costs that once.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import platform

# Parameters of mallopt, from glibc's malloc.h.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX, _ARENA_MAX = -1, -2, -4, -8
_PAD = 64 << 20  # bytes by which the heap grows at least
_HUGE = 2 << 20  # bytes of a huge page
_SHARE = 4  # of the machine's memory, 1 / _SHARE is laid out in huge pages; what lies beyond comes in small ones


def keep_memory() -> bool:
    """Lets this process keep what it frees; to be called before JAX starts its threads.

    The process then holds the most that it ever used, and no more. Whether it could be done: only glibc can.
    """
    if platform.libc_ver()[0] != "glibc":
        return False
    libc = ctypes.CDLL(None)
    # One heap for all threads (those of others can't hold large blocks), never trimmed, and nothing outside it.
    wanted = ((_ARENA_MAX, 1), (_MMAP_MAX, 0), (_TRIM_THRESHOLD, -1), (_TOP_PAD, _PAD))
    if not all([libc.mallopt(*one) for one in wanted]):
        return False
    _ask_for_huge_pages(libc, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // _SHARE)
    return True


def _ask_for_huge_pages(libc: ctypes.CDLL, size: int) -> None:
    """Lays out ``size`` bytes of heap, without touching them, and asks the kernel for huge pages there.

    It may refuse either; the heap then is as good as it was.
    """
    libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
    libc.free.restype, libc.free.argtypes = None, [ctypes.c_void_p]
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    start = libc.malloc(size)
    if not start:
        return
    first = -(-start // _HUGE) * _HUGE
    libc.madvise(first, (start + size - first) // _HUGE * _HUGE, mmap.MADV_HUGEPAGE)
    libc.free(start)
