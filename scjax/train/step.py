"""The state that a training carries from step to step, and the step over all devices."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Integer

from scjax.nn.cpu.backend import fast_compile_options, scenes_at_once
from scjax.nn.functional import Params, Path
from scjax.nn.sharding import AXIS, RULES, mesh_of_processes, partition_specs, scene_mesh
from scjax.scene.pytree import Replaceable, pytree
from scjax.train.ema import update_ema
from scjax.train.flat_params import FlatParams
from scjax.train.gradients import FlatGradients, Gradients, LossFn, ShardedGradients
from scjax.train.malloc import give_back_memory
from scjax.train.muon import muon
from scjax.train.optimizer import adamw
from scjax.train.param_groups import Groups, ParamGroups, trained
from scjax.train.tree_params import TreeParams

Metrics = dict[str, Array]


@pytree
class TrainState(Replaceable):
    """Step counter, parameters and their moving average in groups (``ParamGroups``), moments of the optimizer."""

    step: jax.Array
    params: Groups
    ema: Groups
    optimizer: Any


def make_param_groups(sharding: str, params: Params, frozen: frozenset[Path] = frozenset()) -> ParamGroups:
    """How the state holds parameters of these shapes: flat vectors, or arrays sharded by rules (FSDP).

    Raises:
      ValueError: unknown ``sharding``.
    """
    if sharding == "flat":
        return FlatParams.of(params, frozen)
    if sharding == "fsdp":
        return TreeParams.of(params, frozen)
    raise ValueError(f'config.sharding must be "flat" or "fsdp", not {sharding!r}')


def make_optimizer(config: Any, param_groups: ParamGroups) -> optax.GradientTransformation:
    """The optimizer of ``config.optimizer`` for ``config.steps`` steps.

    Raises:
      ValueError: unknown kind, or a schedule that ends before its warm-up does.
    """
    options = config.optimizer.to_dict()
    kind = options.pop("kind")
    if kind == "adamw":
        return adamw(**options, steps=config.steps)
    if kind == "muon":
        return muon(param_groups, **options, steps=config.steps)
    raise ValueError(f'--config.optimizer.kind must be "adamw" or "muon", not {kind!r}')


def initial_state(params: Params, param_groups: ParamGroups, optimizer: optax.GradientTransformation) -> TrainState:
    """The state of step 0; the moving average starts as a copy, since donated buffers may not be shared."""
    groups = jax.tree.map(jnp.asarray, param_groups.pack(jax.device_get(params)))
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        params=groups,
        ema=jax.tree.map(jnp.copy, groups),
        optimizer=optimizer.init(trained(groups)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class TrainingStep:
    """A step of a whole batch: every device takes an equal share of the scenes, gradients are averaged.

    The random numbers of a scene come from ``seed`` and the scene's index in the stream. So neither the number of
    devices nor that of processes changes a step, apart from rounding.

    A step is three programs (``Gradients``). Only the one in the middle is compiled for every padded size.

    Attributes:
      loss: see ``LossFn``.
      param_groups: how the state holds the parameters; those of the frozen group stay as they are.
      batch_size: scenes in a step over all processes; of a single process as many devices are used as divide it.
      devices: of this process. Default: all of all processes.
      at_once: largest number of scenes that a device works on at once. Default: ``scenes_at_once``.
    """

    loss: LossFn
    param_groups: ParamGroups
    optimizer: optax.GradientTransformation
    ema_decay: float
    seed: int
    batch_size: int
    devices: Sequence[jax.Device] | None = None  # pyright: ignore[reportInvalidTypeForm]
    at_once: int | None = None

    @property
    def mesh(self) -> Mesh:
        """The devices that share a batch."""
        if self.devices is None:
            return mesh_of_processes(self.batch_size)
        return scene_mesh(self.batch_size, self.devices)

    def place(self, state: TrainState) -> TrainState:
        """The state on the devices, as the rules of ``param_groups.sharding`` spread it."""
        return jax.device_put(state, self._shardings(state))

    def __call__(
        self, state: TrainState, batch: Any, index: Integer[Array | np.ndarray, " b"]
    ) -> tuple[TrainState, Metrics]:
        """(state, rows of this process, their indices in the stream) -> (new state, metrics); donates ``state``."""
        spread = NamedSharding(self.mesh, PartitionSpec(AXIS))
        rows, numbers = jax.tree.map(
            lambda x: jax.make_array_from_process_local_data(spread, np.asarray(x)), (batch, index)
        )
        # A device whose share is still being copied starts late, and the others wait for its gradients.
        jax.block_until_ready((rows, numbers))
        if not isinstance(state.step.sharding, NamedSharding):  # to look at every leaf in every step takes long
            state = self.place(state)
        params = self._gather(state.params)
        (loss, terms), gradients = self._program_of(params, rows, numbers)(params, rows, numbers)
        state, norms = self._update(state, gradients)
        return state, {"loss": loss, **terms, **norms}

    def _program_of(self, params: Any, batch: Any, index: Array) -> Callable[..., Any]:
        """The gradient of batches of this size, compiled at the first one."""
        leaves, structure = jax.tree.flatten(batch)
        size = (structure, *((x.shape, x.dtype) for x in leaves))
        if size not in self._programs:
            # What compiling took, and what smaller sizes worked with, is not kept: it would add up over the sizes.
            give_back_memory()
            program = jax.jit(self._gradients.of_batch, compiler_options=fast_compile_options())
            self._programs[size] = program.lower(params, batch, index).compile()
            give_back_memory()
        return self._programs[size]

    @functools.cached_property
    def _programs(self) -> dict[tuple[Any, ...], Callable[..., Any]]:
        return {}

    @functools.cached_property
    def _gradients(self) -> Gradients:
        kind = ShardedGradients if self.param_groups.sharding == "fsdp" else FlatGradients
        at_once = self.at_once or scenes_at_once(self.batch_size)
        return kind(self.loss, self.param_groups, self.mesh, self.seed, at_once)

    @functools.cached_property
    def _gather(self) -> Callable[[Groups], Any]:
        return jax.jit(self._gradients.gather, compiler_options=fast_compile_options())

    @functools.cached_property
    def _update(self) -> Callable[[TrainState, Any], tuple[TrainState, Metrics]]:
        def update(state: TrainState, gradients: Any) -> tuple[TrainState, Metrics]:
            gradients = self._gradients.reduce(gradients)
            updates, moments = self.optimizer.update(gradients, state.optimizer, trained(state.params))
            params = {**state.params, **cast(Groups, optax.apply_updates(trained(state.params), updates))}
            ema = update_ema(state.ema, params, state.step + 1, self.ema_decay)
            norms = {"gradient_norm": optax.tree.norm(gradients), "update_norm": optax.tree.norm(updates)}
            new = TrainState(step=state.step + 1, params=params, ema=ema, optimizer=moments)
            return jax.lax.with_sharding_constraint(new, self._shardings(new)), norms

        return jax.jit(update, donate_argnums=0, compiler_options=fast_compile_options())

    def _shardings(self, tree: Any) -> Any:
        specs = partition_specs(tree, RULES[self.param_groups.sharding], self.mesh.size)
        return jax.tree.map(lambda spec: NamedSharding(self.mesh, spec), specs)
