"""How fast are frames of a log drawn and written, and how fast is its motion measured?

    python -m benchmarks.motion LOG  # a log or recording of any format; by default one of the synthetic world

Times are CPU seconds of this process, so other work on the machine changes them little.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from scjax.metrics.driving import driving_sums
from scjax.metrics.realism_of_motion import realism_of_motion
from scjax.scene import Log
from scjax.viz import animate, frames_of

ROLLOUTS = 32
NOISE = 0.05  # m per step, of the random walks that stand for roll-outs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", nargs="?")
    log = _read_log(parser.parse_args().log)
    print(
        f"{log.num_objects} objects, {log.num_steps} steps, {len(log.lanes)} lanes, {len(log.signal_lane_ids)} signals"
    )
    for heading_up in (False, True):
        view = "heading up" if heading_up else "north up"
        steps = log.num_steps / _seconds(lambda turns=heading_up: list(frames_of(log, heading_up=turns)))
        print(f"{view}: {steps:.0f} frames/s drawn")
        for suffix in ("gif", "mp4"):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"clip.{suffix}"
                rate = log.num_steps / _seconds(lambda p=path, turns=heading_up: animate(log, p, heading_up=turns))
                print(f"{view}: {rate:.0f} frames/s drawn and written as {suffix}, {path.stat().st_size // 1000} kB")
    rollouts = [_noisy(log, seed) for seed in range(ROLLOUTS)]
    print(f"realism_of_motion with {ROLLOUTS} roll-outs: {_seconds(lambda: realism_of_motion(log, rollouts)):.2f} s")
    print(f"driving_sums: {_seconds(lambda: driving_sums(log)):.2f} s")


def _read_log(path: str | None) -> Log:
    if path is None:
        from scjax.synthetic.motion import world_logs

        return world_logs(7, 0)[0]
    from scjax.data.imports import import_log

    return import_log(path)


def _noisy(log: Log, seed: int) -> Log:
    walk = np.cumsum(np.random.default_rng(seed).normal(0, NOISE, (log.num_objects, log.num_steps, 2)), 1)
    positions = log.positions.copy()
    positions[..., :2] += walk
    return dataclasses.replace(log, positions=positions)


def _seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start


if __name__ == "__main__":
    main()
