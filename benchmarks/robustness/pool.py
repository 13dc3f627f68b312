"""A worker process that is started again whenever an input hangs or kills it."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

_MOST_GIGABYTES = 7.0  # of a worker and its children; more would take the machine from others
_HERE = Path(__file__).resolve().parents[1]
_CODE = f"""
import sys, types
package = types.ModuleType("benchmarks")
package.__path__ = [{str(_HERE)!r}]
sys.modules["benchmarks"] = package
sys.meta_path = [finder for finder in sys.meta_path if "__editable__" not in getattr(finder, "__module__", "")]
"""
"""Makes these benchmarks importable beside the scjax that is first on the path. Finders of editable installs go: they
would add modules of another checkout to it."""


def child(code: Path, statement: str, *arguments: str, cache: Path, **options: Any) -> subprocess.Popen[str]:
    """A Python process in which scjax is that of the folder ``code``."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(code),
        "SCJAX_CACHE": str(cache),
        "JAX_COMPILATION_CACHE_DIR": str(cache / "jax"),
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
        "XLA_FLAGS": "--xla_cpu_use_fusion_emitters=false",
        "TF_CPP_MIN_LOG_LEVEL": "3",
        "GRPC_VERBOSITY": "NONE",
    }
    command = [sys.executable, "-c", _CODE + statement, *arguments]
    return subprocess.Popen(command, env=environment, text=True, start_new_session=True, **options)


class Worker:
    """One process; ``ask`` returns None where it hung or died."""

    def __init__(self, code: Path, fixtures: Path, work: Path, seed: int):
        self._code, self._fixtures, self._work, self._seed = code, fixtures, work, seed
        self._process: subprocess.Popen[str] | None = None
        self.folder = work / f"input-{os.getpid()}"

    def ask(self, order: dict[str, Any], seconds: float) -> dict[str, Any] | str:
        """The answer to an order, or what happened instead: "hang", "memory" or "died by signal N".

        Args:
          seconds: of processor time, or four times as long on the clock (the machine may be busy).
        """
        process = self._started()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
        except BrokenPipeError:
            return self._end()
        start, cpu = time.monotonic(), _cpu_seconds(process.pid)
        while not select.select([process.stdout], [], [], 0.3)[0]:
            slow = _cpu_seconds(process.pid) - cpu > seconds
            if slow or time.monotonic() - start > 4 * seconds:
                self.close()
                return "hang"
            if _gigabytes(process.pid) > _MOST_GIGABYTES:
                self.close()
                return "memory"
        line = process.stdout.readline()
        return json.loads(line) if line.endswith("\n") else self._end()

    def _started(self) -> subprocess.Popen[str]:
        if self._process is None:
            statement = (
                "from pathlib import Path\nfrom benchmarks.robustness.worker import main\n"
                "main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))"
            )
            arguments = (str(self._fixtures), str(self.folder), str(self._seed))
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            with (self._work / "worker.log").open("a") as log:
                self._process = child(
                    self._code, statement, *arguments, cache=self._work / "cache", stderr=log, cwd=self._code, **pipes
                )
        return self._process

    def _end(self) -> str:
        process = self._process
        assert process is not None
        code = process.wait()
        self.close()
        return f"died by signal {-code}" if code < 0 else f"ended with status {code}"

    def close(self) -> None:
        """Ends the process and those that it started."""
        if self._process is None:
            return
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self._process.wait()
        self._process = None


def _cpu_seconds(pid: int) -> float:
    """Processor time of a process, its ended children included."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _gigabytes(pid: int) -> float:
    """Memory of a process and of its children."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9 + sum(_gigabytes(int(child)) for child in children)
