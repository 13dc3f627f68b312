"""Runs Gymnasium's own checker on driving environments, one for each log: prints one JSON line for each.

python consumers/checks/gymnasium_env.py FILE.npz ...
"""

from __future__ import annotations

import json
import sys
import warnings

from gymnasium.utils.env_checker import check_env

from scjax.nn.startup import start_jax
from scjax.scene import load_log
from scjax.sim.gym import DrivingEnv


class OneSourceEnv(DrivingEnv):
    """An environment of several sources, compiled once, that begins every episode in ``source``."""

    source = 0

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed, options={"source": self.source, **(options or {})})


def main(files: list[str]) -> None:
    start_jax()
    env = OneSourceEnv([load_log(file) for file in files])
    for env.source, file in enumerate(files):
        row = {"file": file, "consumer": "Gymnasium", "ok": True}
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            try:
                check_env(env, skip_render_check=True)
            except Exception as error:  # a judge's errors are results
                row |= {"ok": False, "error": f"{type(error).__name__}: {error}"[:400]}
        if found:
            row |= {"ok": False, "example": [str(one.message)[:200] for one in found[:3]]}
        print("RESULT " + json.dumps(row), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
