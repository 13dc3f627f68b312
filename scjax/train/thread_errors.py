"""Errors that no caller gets: of threads, of finalizers and of tasks that nobody awaits."""

from __future__ import annotations

import contextlib
import logging
import sys
import threading
from collections.abc import Iterator

_MOST = 10
"""Errors to remember: their traces keep arrays alive."""


@contextlib.contextmanager
def collected_thread_errors() -> Iterator[list[BaseException]]:
    """Within it, such errors are collected in the list, instead of being printed with their traces.

    When one file of a checkpoint cannot be written, orbax raises that error and closes its event loop. Its other
    tasks still run. They fail one by one, in threads of Python and of tensorstore, and each would print a trace.
    """
    errors: list[BaseException] = []

    def collect(error: BaseException | None) -> None:
        if error is not None and not isinstance(error, SystemExit) and len(errors) < _MOST:
            errors.append(error)

    def is_no_error(record: logging.LogRecord) -> bool:
        if record.levelno < logging.ERROR:
            return True
        collect(record.exc_info[1] if record.exc_info else RuntimeError(record.getMessage()))
        return False

    logger = logging.getLogger("asyncio")
    hooks = sys.excepthook, sys.unraisablehook, threading.excepthook, logger.filters
    sys.excepthook = lambda _type, error, _trace: collect(error)  # tensorstore calls it from threads of its own
    sys.unraisablehook = lambda unraisable: collect(unraisable.exc_value)
    threading.excepthook = lambda arguments: collect(arguments.exc_value)
    logger.filters = [is_no_error]
    try:
        yield errors
    finally:
        sys.excepthook, sys.unraisablehook, threading.excepthook, logger.filters = hooks
