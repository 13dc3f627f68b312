"""Replays ScenarioNet folders in MetaDrive: prints one JSON line for each scenario. Runs in the consumer's environment.

python consumers/checks/metadrive_replay.py FOLDER ...
"""

from __future__ import annotations

import json
import logging
import pickle
import sys
from pathlib import Path


def main(folders: list[str]) -> None:
    logging.disable(logging.WARNING)
    for folder in folders:
        for row in replay(Path(folder)):
            print("RESULT " + json.dumps(row), flush=True)


def replay(folder: Path):
    """Yields what happened in each scenario of a folder."""
    from metadrive.envs.scenario_env import ScenarioEnv
    from metadrive.policy.replay_policy import ReplayEgoCarPolicy
    from metadrive.scenario.scenario_description import ScenarioDescription

    mapping = pickle.loads((folder / "dataset_mapping.pkl").read_bytes())
    for name in mapping:
        scenario = pickle.loads((folder / mapping[name] / name).read_bytes())
        ScenarioDescription.sanity_check(scenario, check_self_type=True, valid_check=True)
    environment = ScenarioEnv(
        dict(
            agent_policy=ReplayEgoCarPolicy,
            data_directory=str(folder.resolve()),
            num_scenarios=len(mapping),
            horizon=10_000,
            no_traffic=False,
            reactive_traffic=False,
            use_render=False,
            log_level=50,
        )
    )
    try:
        for index, name in enumerate(mapping):
            environment.reset(seed=index)
            steps, info = 0, {}
            is_over = False
            while not is_over:
                _, _, terminated, truncated, info = environment.step([0.0, 0.0])
                steps += 1
                is_over = terminated or truncated
            words = ("arrive_dest", "out_of_road", "crash", "max_step")
            yield {
                "file": str(folder / name),
                "consumer": "MetaDrive",
                "ok": bool(info.get("arrive_dest")),
                "steps": steps,
                "lanes": len(environment.engine.current_map.road_network.graph),
                **{word: bool(info.get(word)) for word in words},
            }
    finally:
        environment.close()


if __name__ == "__main__":
    main(sys.argv[1:])
