"""A pool of worker processes whose results come in order."""

from __future__ import annotations

import concurrent.futures
import concurrent.futures.process
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any


class WorkerPool:
    """``with WorkerPool(workers) as run: run(function, tasks)`` yields the results in order.

    Args:
      workers: number of processes; 0: this process does the work.
      chunk_size: tasks that a process takes at a time.

    Raises:
      ValueError: while results are taken, if a process was killed.
    """

    def __init__(self, workers: int, chunk_size: int = 1):
        context = multiprocessing.get_context("spawn")
        self._pool = concurrent.futures.ProcessPoolExecutor(workers, context, _exit_with_parent) if workers else None
        self._chunk_size = chunk_size

    def __enter__(self) -> Callable[..., Iterator[Any]]:
        return self._run if self._pool else map

    def __exit__(self, *_: object) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def _run(self, function: Callable[..., Any], *tasks: Any) -> Iterator[Any]:
        assert self._pool is not None
        try:
            yield from self._pool.map(function, *tasks, chunksize=self._chunk_size)
        except concurrent.futures.process.BrokenProcessPool as error:
            raise ValueError(
                "a worker process was stopped from outside, perhaps for lack of memory: run the command again, with "
                "fewer --workers"
            ) from error


def _exit_with_parent() -> None:
    """Ends this worker when its parent is gone: idle workers of a killed build would wait forever."""

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
