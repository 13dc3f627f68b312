"""How many scene-steps a second do roll-outs and driving environments take, and how long does compiling take?

    python -m benchmarks.rollouts --out rollouts.json
    python -m benchmarks.rollouts --smoke    # only shows that the script runs

A scene-step is one step of 0.1 s of one scene. Vehicles are evenly spread over the lanes of a synthetic world. The map
is 64 m around its ego, all of it (300 m), or 4 x 4 copies side by side (1.2 km). Times are the least of --repeats. Core
microseconds are the processor time of the whole process, so they hold on a machine with other work too.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.workload import machine
from scjax.nn.sharding import use_every_core
from scjax.scene import AgentType, Log, map_to_log, scene_to_map
from scjax.scene.files import write_text
from scjax.sim.behavior import BehaviorModel
from scjax.sim.constant_velocity import ConstantVelocity
from scjax.sim.gym import DrivingVectorEnv
from scjax.sim.lane_changes import LaneChanges
from scjax.sim.preparation import Start, prepare
from scjax.sim.rollout import roll_out, stack_records
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import TIME_STEP, padded_signals
from scjax.synthetic.recording import object_index, to_log
from scjax.synthetic.world import World, make_world

WORLD = (0, 3)  # seed and number: a city with crossroads
STEPS, AGENTS, SCENES = 50, 64, 8
BEHAVIORS: dict[str, BehaviorModel] = {
    "RouteFollower": RouteFollower(),
    "RouteFollower, lane changes": RouteFollower(lane_changes=LaneChanges()),
    "ConstantVelocity": ConstantVelocity(),
}
_BOX = (4.6, 1.9, 1.6)  # m


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--repeats", type=int, default=5, help="(default: %(default)s)")
    parser.add_argument("--skip", type=int, default=0, help="cases of an earlier run to leave out (default: 0)")
    parser.add_argument("--smoke", action="store_true", help="smallest sizes only")
    args = parser.parse_args()
    use_every_core()
    jax.config.update("jax_enable_compilation_cache", False)
    maps = map_sizes(make_world(*WORLD, event_share=0.0))
    rows = []
    for name, agents, scenes, size in cases(args.smoke)[args.skip :]:
        start = prepare(with_vehicles(maps[size], agents), 0, np.random.default_rng(0))
        timing = measure(_rollout(start, scenes, BEHAVIORS[name]), scenes * STEPS, args.repeats)
        rows.append({"behavior": name, "agents": agents, "scenes": scenes, "map": size, "shape": start.shape} | timing)
        print(json.dumps(rows[-1]), flush=True)
    environments = []
    for count in (1,) if args.smoke else (1, 16, 64):
        run = _environment(with_vehicles(maps["300 m"], 32), count)
        environments.append({"environments": count, "agents": 32} | measure(run, count * STEPS, args.repeats))
        print(json.dumps(environments[-1]), flush=True)
    if args.out:
        content = {"machine": machine(), "rollouts": rows, "environments": environments}
        write_text(args.out, json.dumps(content, indent=1))


def cases(smoke: bool) -> list[tuple[str, int, int, str]]:
    """Behavior, agents, scenes in the batch and map, each varied alone."""
    if smoke:
        return [("ConstantVelocity", 16, 1, "64 m")]
    names = list(BEHAVIORS)
    return [
        *((name, AGENTS, SCENES, "300 m") for name in names),
        *((names[0], agents, SCENES, "300 m") for agents in (16, 128)),
        *((names[0], AGENTS, scenes, "300 m") for scenes in (1, 32)),
        *((names[0], AGENTS, SCENES, size) for size in ("64 m", "1.2 km")),
        (names[0], 256, SCENES, "300 m"),
    ]


def map_sizes(world: World) -> dict[str, Log]:
    """Logs of one step with the lanes of maps of three sizes."""
    from scjax.data.log_crop import crop_log

    log = to_log(world)
    ego = world.egos[0]
    scene = crop_log(log, ego.moment, object_index(world, ego.moment, ego.agent))
    log = log.select_steps([ego.moment])
    return {"64 m": map_to_log(scene_to_map(scene)), "300 m": log, "1.2 km": _copies(log, 4, 310.0)}


def _copies(log: Log, side: int, distance: float) -> Log:
    """``side`` x ``side`` copies of the lanes, without neighbors and signals."""
    lanes = []
    for copy in range(side * side):
        shift = np.array([*divmod(copy, side), 0]) * distance
        names = {lane.id: f"{copy}.{lane.id}" for lane in log.lanes}
        for lane in log.lanes:
            links = {name: tuple(names[one] for one in getattr(lane, name)) for name in ("predecessors", "successors")}
            moved = {"id": names[lane.id], "points": lane.points + shift, "left_neighbors": (), "right_neighbors": ()}
            lanes.append(dataclasses.replace(lane, **moved, **links))
    nothing = {"signal_lane_ids": (), "signal_states": np.zeros((0, 1), np.int32), "signal_positions": np.zeros((0, 3))}
    return dataclasses.replace(log, lanes=tuple(lanes), **nothing)


def with_vehicles(log: Log, count: int) -> Log:
    """The log with ``count`` vehicles at 5 m/s, evenly spread over its lanes for cars; the first is the ego."""
    points, headings = [], []
    for lane in log.lanes:
        if lane.lane_type == "not_for_cars":
            continue
        step = np.diff(lane.points[:, :2], axis=0)
        points.append(lane.points[:-1])
        headings.append(np.arctan2(step[:, 1], step[:, 0]))
    rows = np.linspace(0, sum(map(len, points)) - 1, count).astype(int)
    place, heading = np.concatenate(points)[rows], np.concatenate(headings)[rows]
    place = np.where(np.isfinite(place), place, 0.0) + np.array([0.0, 0.0, _BOX[2] / 2])
    return dataclasses.replace(
        log,
        object_ids=tuple(map(str, range(count))),
        object_types=np.full(count, int(AgentType.VEHICLE), log.object_types.dtype),
        valid=np.ones((count, 1), bool),
        positions=place[:, None],
        headings=heading[:, None],
        velocities=5.0 * np.stack([np.cos(heading), np.sin(heading)], -1)[:, None],
        sizes=np.tile(np.array(_BOX), (count, 1)),
        ego_index=0,
    )


def _rollout(start: Start, scenes: int, behavior: BehaviorModel) -> Callable[[], Any]:
    parts = ("network", "agents", "places")
    stacks = [jax.device_put(stack_records([getattr(start, name)] * scenes)) for name in parts]
    signals = jax.device_put(padded_signals([start] * scenes, STEPS))
    keys = jax.random.split(jax.random.key(0), scenes)
    return lambda: jax.block_until_ready(roll_out(keys, *stacks, signals, behavior=behavior, dt=TIME_STEP))


def _environment(source: Log, count: int) -> Callable[[], Any]:
    env = DrivingVectorEnv(source, count, seconds=600.0)
    env.reset(seed=0)
    actions = np.zeros((count, 2))

    def run() -> None:
        for _ in range(STEPS):
            env.step(actions)

    return run


def measure(run: Callable[[], Any], scene_steps: int, repeats: int) -> dict[str, float]:
    """Seconds of the first call on the clock and of the processor; then rates on the clock and core microseconds."""
    first = _seconds(run)
    clock, cores = np.min([_seconds(run) for _ in range(repeats)], axis=0)
    return {
        "compile_s": round(first[0] - clock, 2),
        "compile_core_s": round(first[1] - cores, 2),
        "scene_steps_per_s": round(scene_steps / clock, 1),
        "core_us": round(1e6 * cores / scene_steps, 1),
        "load": round(os.getloadavg()[0], 1),
    }


def _seconds(run: Callable[[], Any]) -> tuple[float, float]:
    """Of one call: on the clock and of the processor."""
    clock, cores = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - clock, time.process_time() - cores


if __name__ == "__main__":
    main()
