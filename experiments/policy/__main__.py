"""Can a policy learn to drive in scjax.sim.gym? PPO of skrl on synthetic worlds, scored on worlds it never saw.

    bash experiments/policy/install.sh runs/policy_env
    taskset -c 1 nice -n 5 runs/policy_env/bin/python -m experiments.policy --out docs/results/policy

Every score is of 12 s from each held-out moment, with two seeds of the traffic. RUNS keeps the networks and all scores:
the same command continues there, with a new state of Adam, since skrl does not restore it.

Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from gymnasium.vector import AutoresetMode

from experiments.policy.page import make_page
from experiments.policy.score import Driver, baselines, score
from experiments.policy.sources import driving_sources
from experiments.studies.page import script_parser
from scjax.scene.files import write_text
from scjax.sim.gym import DrivingVectorEnv

HELD_OUT = 100_000  # first of the worlds on which policies are scored
SECONDS = 12.0
_SCORE_SEEDS = range(2)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.policy", __doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs/policy"), help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, required=True, help="page, without ending")
    parser.add_argument("--scenes", type=int, default=32, help="for training, and as many held out (%(default)s)")
    parser.add_argument("--rollouts", type=int, default=200, help="of 64 steps in each scene (%(default)s)")
    parser.add_argument("--parts", type=int, default=10, help="scores on the curve (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of networks and actions (%(default)s)")
    args = parser.parse_args(arguments)
    args.runs.mkdir(parents=True, exist_ok=True)
    fixed, curve = (_stored(args.runs / name) for name in ("baselines.json", "curve.json"))
    if not fixed or len(curve) <= args.parts:
        held_out = DrivingVectorEnv(driving_sources(0, HELD_OUT, args.scenes), args.scenes, seconds=SECONDS)
        if not fixed:
            fixed = {name: dataclasses.asdict(score(held_out, one, _SCORE_SEEDS)) for name, one in baselines().items()}
            write_text(args.runs / "baselines.json", json.dumps(fixed, indent=1))
        mode = AutoresetMode.SAME_STEP
        training = DrivingVectorEnv(
            driving_sources(0, 0, args.scenes), args.scenes, seconds=SECONDS, autoreset_mode=mode
        )
        curve = train(training, held_out, args.runs, args.rollouts, args.parts, args.seed)
    command = f"python -m experiments.policy {' '.join(sys.argv[1:] if arguments is None else arguments)}"
    make_page(args.out, command, curve, fixed, args.scenes)


def _stored(path: Path) -> Any:
    """The content of a JSON file, or an empty list."""
    return json.loads(path.read_text()) if path.exists() else []


def train(
    env: DrivingVectorEnv, held_out: DrivingVectorEnv, runs: Path, rollouts: int, parts: int, seed: int
) -> list[dict[str, float]]:
    """Trains in ``parts`` and scores before the first and after each; what RUNS holds already is not done again.

    Returns:
      One dictionary a score: the fields of ``Score``, steps of training, seconds of this process and the load.
    """
    from skrl.trainers.jax import SequentialTrainer
    from skrl.utils import set_seed

    from experiments.policy.networks import ROLLOUT, make_agent

    set_seed(seed)
    agent, wrapped = make_agent(env)
    steps = ROLLOUT * (rollouts // parts)
    options = {"timesteps": steps, "disable_progressbar": True, "headless": True, "close_environment_at_exit": False}
    trainer = SequentialTrainer(cfg=options, env=wrapped, agents=agent)
    curve_file, weights = runs / "curve.json", runs / "agent.pickle"
    curve = _stored(curve_file)
    if curve and weights.exists():
        agent.load(str(weights))
        set_seed(seed + len(curve))
    for part in range(len(curve), parts + 1):
        began = time.time()
        if part:
            trainer.train()
            agent.save(str(weights))
        elapsed = time.time() - began
        agent.enable_training_mode(False)
        result = score(held_out, learned_driver(agent), _SCORE_SEEDS)
        line = {"steps": part * steps * env.num_envs, "seconds": elapsed, "load": os.getloadavg()[0]}
        curve.append(dataclasses.asdict(result) | line)
        write_text(curve_file, json.dumps(curve, indent=1))
        print(json.dumps(curve[-1]), flush=True)
    return curve


def learned_driver(agent) -> Driver:
    """The mean actions of a policy of skrl."""
    policy = agent.models["policy"]
    mean = jax.jit(lambda parameters, inputs: policy.apply(parameters, inputs, "policy")[0])

    def act(boxes: dict[str, np.ndarray]) -> np.ndarray:
        flat = np.concatenate([boxes[name].reshape(len(boxes[name]), -1) for name in sorted(boxes)], -1)
        return np.asarray(mean(policy.state_dict.params, {"observations": flat.astype(np.float32)}))

    return act


if __name__ == "__main__":
    main()
