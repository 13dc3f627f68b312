"""Three training steps of a small network, by one process or by one of several.

On the command line: python -m tests.factories.process_steps COORDINATOR_ADDRESS NUM_PROCESSES PROCESS_ID FILE
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from scjax.nn import random
from scjax.nn.sharding import host_copy
from scjax.train.optimizer import adamw
from scjax.train.step import TrainingStep, initial_state, make_param_groups

PARAMS = {"layer": {"kernel": np.linspace(-1.0, 1.0, 8, dtype=np.float32).reshape(4, 2), "bias": np.zeros(2)}}
BATCH_SIZE = 4


def _noisy_loss(params, batch, keys):
    layer = params["layer"]
    error = jnp.tanh(batch @ layer["kernel"] + layer["bias"][None]) - random.normal(keys, (len(batch), 2))
    return jnp.square(error).mean(), {"error": jnp.abs(error).mean()}


def run_process_steps(sharding: str) -> dict[str, list[float]]:
    """The loss of every step, and the kernel after the last one."""
    groups = make_param_groups(sharding, PARAMS)
    optimizer = adamw(learning_rate=1e-2, steps=10, warmup=1)
    step = TrainingStep(_noisy_loss, groups, optimizer, ema_decay=0.9, seed=0, batch_size=BATCH_SIZE)
    state = step.place(initial_state(PARAMS, groups, optimizer))
    rows, losses = np.random.default_rng(0).normal(size=(BATCH_SIZE, 4)).astype(np.float32), []
    own = slice(jax.process_index(), None, jax.process_count())  # as the loaders share a batch
    for number in range(3):
        index = np.arange(BATCH_SIZE, dtype=np.uint32) + 40 * number
        state, metrics = step(state, rows[own], index[own])
        losses.append(float(metrics["loss"]))
    kernel = groups.unpack(host_copy(state.params))["layer"]["kernel"]
    return {"losses": losses, "kernel": np.asarray(kernel).ravel().tolist()}


if __name__ == "__main__":
    address, processes, process, file = sys.argv[1:]
    jax.distributed.initialize(address, num_processes=int(processes), process_id=int(process))
    Path(file).write_text(json.dumps({sharding: run_process_steps(sharding) for sharding in ("flat", "fsdp")}))
