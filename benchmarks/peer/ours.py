"""scjax on the workload, as a worker of ``benchmarks.peer``: the same questions and answers as ``release.py``.

    python -m benchmarks.peer.ours FOLDER JOB

FOLDER is ignored.
"""

from __future__ import annotations

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory

    keep_memory()

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import jax

from benchmarks import workload
from benchmarks.sampler import guided_sampler, sampling_pass
from benchmarks.steps import denoiser_config, step_of
from benchmarks.train_step import training_pass
from scjax.nn.sharding import use_every_core

STEPS = 100


def main(job: dict[str, Any]) -> None:
    """Builds the work of ``job`` and answers on standard output."""
    use_every_core()
    start = time.perf_counter()
    run = (training if job["work"] == "train" else sampling)(job)
    run()
    first_pass = time.perf_counter() - start
    start = time.perf_counter()
    run()
    again = time.perf_counter() - start
    roofline = workload.rooflines()[job["compute"]]
    say({"ready": True, "compile_s": first_pass - again, "first_pass_s": first_pass, "roofline": roofline})
    for line in sys.stdin:
        if line.strip() == "end":
            break
        start = time.perf_counter()
        run()
        say({"seconds": time.perf_counter() - start})
    say({"peak_gb": workload.peak_memory_gb(), "jax": jax.__version__})


def say(answer: dict[str, Any]) -> None:
    """One answer to the driver."""
    print(json.dumps(answer), flush=True)


def training(job: dict[str, Any]) -> Callable[[], None]:
    """One pass of optimizer steps."""
    scenes = sum(len(part) for part in job["parts"])
    return training_pass(step_of(job["kind"], job["batch"], scenes, job["compute"], job["size"]), job["batch"])


def sampling(job: dict[str, Any]) -> Callable[[], None]:
    """Guided sampling of latents in 100 steps."""
    config = denoiser_config(job["kind"], job["compute"], job["size"])
    return sampling_pass(guided_sampler(config, "ddpm", STEPS), job["kind"], workload.padded(job["parts"]))


if __name__ == "__main__":
    main(json.loads(sys.argv[2]))
