"""What a training step carries from one step to the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from experiments.reporting import Reporter
from scjax.data.pipeline import PipelineConfig
from scjax.diffusion.ema import update_ema
from scjax.model import Model
from scjax.nn.functional import Params
from scjax.pytree import pytree
from scjax.representation import Representation
from scjax.scene import Scene


@pytree
class TrainState:
    """Step counter, parameters, their moving average and the optimiser's moments."""

    step: jax.Array
    params: Params
    ema: Params
    optimiser: Any


class Stage(NamedTuple):
    """One training stage as functions over a ``TrainState``; ``step`` is jitted and donates its state."""

    representation: Representation
    init: Callable[[jax.Array], TrainState]
    step: Callable[[TrainState, Scene], tuple[TrainState, dict[str, jax.Array]]]
    evaluate: Callable[[TrainState], dict[str, float]]
    pictures: Callable[[TrainState, int, Reporter], None]
    export: Callable[[TrainState, dict], Model]


def initial(params: Params, optimiser: optax.GradientTransformation) -> TrainState:
    """Step 0; the average starts as a copy, since donated buffers may not be shared."""
    ema = jax.tree.map(jnp.copy, params)
    return TrainState(step=jnp.zeros((), jnp.int32), params=params, ema=ema, optimiser=optimiser.init(params))


def apply_gradients(
    state: TrainState, gradients: Params, optimiser: optax.GradientTransformation, ema_decay: float
) -> tuple[TrainState, dict[str, jax.Array]]:
    """One optimiser and EMA update, and the norms worth watching."""
    updates, moments = optimiser.update(gradients, state.optimiser, state.params)
    params = optax.apply_updates(state.params, updates)
    step = state.step + 1
    ema = update_ema(state.ema, params, step, ema_decay)
    norms = {"gradient_norm": optax.tree.norm(gradients), "update_norm": optax.tree.norm(updates)}
    return TrainState(step=step, params=params, ema=ema, optimiser=moments), norms


def pipeline_config(batch: dict[str, Any], **changes: Any) -> PipelineConfig:
    """``config.batch`` as it comes out of JSON (lists for tuples)."""
    fields = {name: _tuples(value) for name, value in batch.items()}
    return PipelineConfig(**{**fields, **changes})


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
