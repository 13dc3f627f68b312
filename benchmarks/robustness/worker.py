"""The process that runs inputs: reads orders from stdin, line by line, and answers each with one line."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness.case import Case, Unavailable

_LIMIT = 64 * 2**30  # bytes of data; XLA reserves far more than it uses, so the parent watches what is used


def main(fixtures: Path, folder: Path, seed: int) -> None:
    """Answers {"area": A} with the number of its inputs, and {"area": A, "index": K} with how input K ended."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print goes to the log
    resource.setrlimit(resource.RLIMIT_DATA, (_LIMIT, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    cases: dict[str, list[Case]] = {}
    for line in sys.stdin:
        order = json.loads(line)
        answers.write(json.dumps(_answer(order, cases, fixtures, folder, seed)) + "\n")


def _answer(order: dict[str, Any], cases: dict[str, list[Case]], fixtures: Path, folder: Path, seed: int) -> Any:
    from benchmarks.robustness.areas import AREAS
    from benchmarks.robustness.outcome import judge

    area = order["area"]
    if area not in cases:
        cases.clear()
        try:
            _start(area)
            rng = np.random.default_rng([seed, *area.encode()])
            listed = list(AREAS[area].inputs(rng, fixtures))
            cases[area] = [listed[k] for k in rng.permutation(len(listed))]  # so that a share is one of all kinds
        except (Unavailable, FileNotFoundError) as error:
            return {"unavailable": str(error)}
    if "index" not in order:
        return {"inputs": len(cases[area])}
    if "text" in order:
        return {"text": cases[area][order["index"]].text}
    shutil.rmtree(folder, ignore_errors=True)
    own = folder / f"case{order['index']}"  # readers may keep what they read from a path
    own.mkdir(parents=True)
    return dataclasses.asdict(judge(cases[area][order["index"]], own))


def _start(area: str) -> None:
    """What a process does before it uses JAX; commands start processes of their own."""
    if area == "commands":
        return
    from absl import flags, logging

    flags.FLAGS.mark_as_parsed()  # grain reads absl flags even when nobody parsed any
    logging.set_verbosity(logging.FATAL)
    import jax

    jax.config.update("jax_compilation_cache_dir", os.environ.get("JAX_COMPILATION_CACHE_DIR"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
