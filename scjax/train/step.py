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

from scjax.nn.cpu.backend import fast_compile_options, scenes_per_step
from scjax.nn.functional import Params, Path
from scjax.nn.random import row_keys
from scjax.nn.sharding import AXIS, RULES, partition_specs, scene_mesh, sharded_axis
from scjax.scene.pytree import Replaceable, pytree
from scjax.train.ema import update_ema
from scjax.train.flat_params import FlatParams
from scjax.train.muon import muon
from scjax.train.optimizer import adamw
from scjax.train.param_groups import Groups, ParamGroups, trained
from scjax.train.tree_params import TreeParams

LossFn = Callable[[Params, Any, Array], tuple[Array, dict[str, Array]]]
"""(parameters, batch [B], keys [B]) -> loss and terms, both means over the scenes of the batch."""

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

    Attributes:
      loss: see ``LossFn``.
      param_groups: how the state holds the parameters; those of the frozen group stay as they are.
      batch_size: scenes in a step over all processes; as many devices are used as divide it.
      devices: default: all.
      at_once: largest number of scenes that a device works on at once; gradients of the parts of its share add up.
        Default: ``scenes_per_step``.
    """

    loss: LossFn
    param_groups: ParamGroups
    optimizer: optax.GradientTransformation
    ema_decay: float
    seed: int
    batch_size: int
    devices: Sequence[jax.Device] | None = None  # pyright: ignore[reportInvalidTypeForm]
    at_once: int | None = None

    def __post_init__(self):
        object.__setattr__(
            self, "_program", jax.jit(self._step, donate_argnums=0, compiler_options=fast_compile_options())
        )

    @property
    def mesh(self) -> Mesh:
        """The devices that share a batch."""
        return scene_mesh(self.batch_size, self.devices)

    def place(self, state: TrainState) -> TrainState:
        """The state on the devices, as the rules of ``param_groups.sharding`` spread it."""
        return jax.device_put(state, self._shardings(state))

    def __call__(
        self, state: TrainState, batch: Any, index: Integer[Array | np.ndarray, " b"]
    ) -> tuple[TrainState, Metrics]:
        """(state, rows of this process, their indices in the stream) -> (new state, metrics); donates ``state``."""
        spread = NamedSharding(self.mesh, PartitionSpec(AXIS))
        batch, index = jax.tree.map(
            lambda x: jax.make_array_from_process_local_data(spread, np.asarray(x)), (batch, index)
        )
        # A device whose share is still being copied starts late, and the others wait for its gradients.
        jax.block_until_ready((batch, index))
        if not isinstance(state.step.sharding, NamedSharding):  # to look at every leaf in every step takes long
            state = self.place(state)
        return self._program(state, batch, index)  # pyright: ignore[reportAttributeAccessIssue]

    def _specs(self, tree: Any) -> Any:
        return partition_specs(tree, RULES[self.param_groups.sharding], self.mesh.size)

    def _shardings(self, tree: Any) -> Any:
        return jax.tree.map(lambda spec: NamedSharding(self.mesh, spec), self._specs(tree))

    def _step(self, state: TrainState, batch: Any, index: Array) -> tuple[TrainState, Metrics]:
        specs = self._specs(state.params)
        gradients_of = jax.shard_map(
            functools.partial(self._share_gradients, specs),
            mesh=self.mesh,
            in_specs=(specs, PartitionSpec(AXIS), PartitionSpec(AXIS)),
            out_specs=(PartitionSpec(), trained(specs)),
            check_vma=False,
        )
        (loss, terms), gradients = gradients_of(state.params, batch, index)
        updates, moments = self.optimizer.update(gradients, state.optimizer, trained(state.params))
        params = {**state.params, **cast(Groups, optax.apply_updates(trained(state.params), updates))}
        ema = update_ema(state.ema, params, state.step + 1, self.ema_decay)
        norms = {"gradient_norm": optax.tree.norm(gradients), "update_norm": optax.tree.norm(updates)}
        new = TrainState(step=state.step + 1, params=params, ema=ema, optimizer=moments)
        return jax.lax.with_sharding_constraint(new, self._shardings(new)), {"loss": loss, **terms, **norms}

    def _share_gradients(self, specs: Any, shards: Groups, batch: Any, index: Array) -> tuple[Any, Groups]:
        """((loss, terms), gradients of the shards): means over all devices; this one computes its share of scenes."""
        base_key = jax.random.fold_in(jax.random.key(self.seed), 1)
        parts = _num_parts(len(index), self.at_once or scenes_per_step(self.batch_size))
        gradient = self._tree_gradient if self.param_groups.sharding == "fsdp" else self._flat_gradient
        part_gradient = gradient(specs, shards)
        result, gradients = _mean_of_parts(
            lambda rows, numbers: part_gradient(rows, row_keys(base_key, numbers)), parts, batch, index
        )
        reduce = _mean_of_shards if self.param_groups.sharding == "fsdp" else _scatter_mean
        return jax.lax.pmean(result, AXIS), jax.tree.map(
            functools.partial(reduce, self.mesh.size), gradients, trained(specs)
        )

    def _flat_gradient(self, specs: Any, shards: Groups) -> Callable[[Any, Array], tuple[Any, Groups]]:
        """(batch, keys) -> (loss, terms), gradients of the whole vectors.

        By arrays that are packed afterwards: by vectors, the gradient of every array would be padded to their length.
        """
        params = self.param_groups.unpack(jax.tree.map(_gather, shards, specs))

        def gradient(batch: Any, keys: Array) -> tuple[Any, Groups]:
            result, gradients = jax.value_and_grad(self.loss, has_aux=True)(params, batch, keys)
            return result, trained(self.param_groups.pack(gradients))

        return gradient

    def _tree_gradient(self, specs: Any, shards: Groups) -> Callable[[Any, Array], tuple[Any, Groups]]:
        """(batch, keys) -> (loss, terms), gradients of the shards, summed over devices where an axis is sharded.

        Arrays are gathered where they are used, and gathered again on the way back instead of kept.
        """

        @functools.partial(jax.checkpoint, policy=lambda primitive, *_, **__: primitive.name != "all_gather")
        def loss(trained_shards: Groups, batch: Any, keys: Array) -> tuple[Array, dict[str, Array]]:
            groups = jax.tree.map(_gather, shards | trained_shards, specs)
            return self.loss(self.param_groups.unpack(groups), batch, keys)

        return functools.partial(jax.value_and_grad(loss, has_aux=True), trained(shards))


def _gather(shard: Array, spec: PartitionSpec) -> Array:
    axis = sharded_axis(spec)
    return shard if axis is None else jax.lax.all_gather(shard, AXIS, axis=axis, tiled=True)


def _scatter_mean(devices: int, gradient: Array, spec: PartitionSpec) -> Array:
    """The mean over devices of gradients of the whole array, of which each device gets its shard."""
    axis = sharded_axis(spec)
    if axis is None:
        return jax.lax.pmean(gradient, AXIS)
    return jax.lax.psum_scatter(gradient, AXIS, scatter_dimension=axis, tiled=True) / devices


def _mean_of_shards(devices: int, gradient: Array, spec: PartitionSpec) -> Array:
    """The mean over devices of gradients; those of sharded arrays are sums already."""
    return jax.lax.pmean(gradient, AXIS) if sharded_axis(spec) is None else gradient / devices


def _mean_of_parts(function: Callable[[Any, Array], Any], parts: int, batch: Any, index: Integer[Array, " b"]) -> Any:
    """The mean of ``function`` over equal parts of the rows, one part after another."""
    if parts == 1:
        return function(batch, index)
    split = jax.tree.map(lambda x: x.reshape(parts, -1, *x.shape[1:]), (batch, index))

    def add(total: Any, part: tuple[Any, Array]) -> tuple[Any, None]:
        return jax.tree.map(jnp.add, total, function(*part)), None

    shapes = jax.eval_shape(function, *jax.tree.map(lambda x: x[0], split))
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    total, _ = jax.lax.scan(add, zeros, split)
    return jax.tree.map(lambda x: x / parts, total)


def _num_parts(scenes: int, most: int) -> int:
    """The smallest number of equal parts of at most ``most`` scenes."""
    return next(n for n in range(1, scenes + 1) if scenes % n == 0 and scenes // n <= most)
