"""How one input ends: runs it, measures it, and judges it."""

from __future__ import annotations

import os
import re
import subprocess
import time
import traceback
import warnings
from pathlib import Path

from benchmarks.robustness.case import Case, Refused, Result

MEMORY = 1000.0  # MB that an input may add
_SHORT = 200  # characters of a message


def judge(case: Case, folder: Path) -> Result:
    """Writes the files of a case, runs it, and says how it ended. Only the end of a process is left to the caller."""
    case.write(folder)
    before = _start_memory()
    start = time.perf_counter()
    outcome, error, place, message = _run(case, folder)
    seconds, megabytes = time.perf_counter() - start, _memory_peak() - before
    if megabytes > MEMORY and outcome != "traceback":
        outcome, message = "memory", f"{megabytes:.0f} MB more ({outcome}) {message}"
    return Result(outcome, case.text, error, place, message[:_SHORT], round(seconds, 3), round(megabytes, 1))


def _run(case: Case, folder: Path) -> tuple[str, str, str, str]:
    """Outcome, type of the exception, its place, message."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = case.run(folder)
    except subprocess.TimeoutExpired as error:
        return "hang", "", "", str(error)
    except MemoryError as error:
        return "memory", type(error).__name__, _place(error), str(error)
    except (ValueError, FileNotFoundError) as error:
        return _refusal(str(error), case.names), type(error).__name__, _place(error), str(error)
    except (Exception, SystemExit) as error:
        return "traceback", type(error).__name__, _place(error), str(error)
    if isinstance(result, Refused):
        if "MemoryError" in result.text:
            return "memory", "MemoryError", _traceback_place(result.text), result.text[-_SHORT:]
        if "Traceback (most recent call last)" in result.text or result.code < 0:
            return "traceback", _traceback_type(result), _traceback_place(result.text), result.text[-_SHORT:]
        return _refusal(result.text, case.names), f"exit {result.code}", "", result.text[-_SHORT:]
    try:
        fault = case.check(result)
    except Exception as error:  # the result is not of the form that the check reads
        fault = f"the check of the result ends in {type(error).__name__}: {error}"
    return ("wrong", "", "", fault) if fault else ("ok", "", "", "")


def _refusal(message: str, names: tuple[str, ...]) -> str:
    named = any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", message, re.IGNORECASE) for name in names)
    return "clean" if named else "unnamed"


def _place(error: BaseException) -> str:
    """File and line of the last frame inside scjax or the experiments, else of the last frame."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "/scjax/" in frame.filename or "/experiments/" in frame.filename]
    if not frames:
        return ""
    last = (own or frames)[-1]
    return f"{_short(last.filename)}:{last.lineno}"


def _short(path: str) -> str:
    for root in ("/scjax/", "/experiments/", "/site-packages/"):
        if root in path:
            return root.strip("/").replace("site-packages", "") + "/" + path.rsplit(root, 1)[1]
    return path


def _traceback_place(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip().startswith('File "')]
    own = [line for line in lines if "/scjax/" in line or "/experiments/" in line] or lines
    if not own:
        return ""
    path, _, rest = own[-1].removeprefix('File "').partition('"')
    return f"{_short(path)}:{rest.split('line ')[-1].split(',')[0]}"


def _traceback_type(result: Refused) -> str:
    if result.code < 0:
        return f"signal {-result.code}"
    lines = [line for line in result.text.splitlines() if line and not line.startswith(" ") and ":" in line]
    return lines[-1].split(":")[0] if lines else "traceback"


def _start_memory() -> float:
    """Resets the peak of this process's memory; returns what it uses now [MB]."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return float("inf")  # the peak cannot be reset here: memory is not measured
    return _status("VmRSS")


def _memory_peak() -> float:
    return _status("VmHWM")


def _status(name: str) -> float:
    try:
        lines = Path(f"/proc/{os.getpid()}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1000 for line in lines if line.startswith(name)), 0.0)
