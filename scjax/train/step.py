"""What a training step carries from one step to the next, and the step itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.sharding import NamedSharding, PartitionSpec

from scjax.data.caption_features import TextStore
from scjax.data.loader import Example, PipelineConfig
from scjax.generate.model import Model
from scjax.models.codec import SceneCodec
from scjax.nn.cpu.backend import scenes_per_step
from scjax.nn.functional import Params
from scjax.nn.sharding import AXIS, scene_mesh
from scjax.scene.pytree import Replaceable, pytree
from scjax.train.ema import update_ema
from scjax.train.flat_params import FlatParams, Vectors, trained
from scjax.train.muon import muon
from scjax.train.optimizer import adamw
from scjax.train.reporter import Reporter

Objective = Callable[[Params, Example, jax.Array], tuple[jax.Array, dict[str, jax.Array]]]


@pytree
class TrainState(Replaceable):
    """Step counter, parameters and their moving average as vectors (``FlatParams``), and the optimiser's moments."""

    step: jax.Array
    params: Vectors
    ema: Vectors
    optimizer: Any


class Stage(NamedTuple):
    """One training stage as functions over a ``TrainState``; ``step`` is a ``training_step``.

    ``texts`` are the captions that its batches carry, if any; ``images`` whether they carry stand-ins for images;
    ``prepare`` completes the state of a run that begins, where something has to be fitted first.
    """

    codec: SceneCodec
    init: Callable[[jax.Array], TrainState]
    step: Callable[[TrainState, Example], tuple[TrainState, dict[str, jax.Array]]]
    evaluate: Callable[[TrainState], dict[str, float]]
    pictures: Callable[[TrainState, int, Reporter], None]
    export: Callable[[TrainState, dict], Model]
    texts: TextStore | None = None
    images: bool = False
    prepare: Callable[[TrainState], TrainState] = lambda state: state


def make_optimizer(config, packing: FlatParams) -> optax.GradientTransformation:
    """What ``config.optimizer`` describes, over ``config.steps``.

    Raises:
      ValueError: unknown kind, or a schedule that ends before its warm-up does.
    """
    options = config.optimizer.to_dict()
    kind = options.pop("kind")
    if kind == "adamw":
        return adamw(**options, steps=config.steps)
    if kind == "muon":
        return muon(packing, **options, steps=config.steps)
    raise ValueError(f'--config.optimiser.kind must be "adamw" or "muon", not {kind!r}')


def initial(params: Params, packing: FlatParams, optimizer: optax.GradientTransformation) -> TrainState:
    """Step 0; the average starts as a copy, since donated buffers may not be shared."""
    vectors = packing.pack(jax.device_get(params))
    return TrainState(
        step=jnp.zeros((), jnp.int32), params=vectors, ema=jax.tree.map(jnp.copy, vectors),
        optimizer=optimizer.init(trained(vectors)),
    )  # fmt: skip


def training_step(
    objective: Objective,
    packing: FlatParams,
    optimizer: optax.GradientTransformation,
    *,
    ema_decay: float,
    seed: int,
    batch_size: int,
    devices: Sequence[jax.Device] | None = None,
    at_once: int | None = None,
) -> Callable[[TrainState, Example], tuple[TrainState, dict[str, jax.Array]]]:
    """A step of the whole batch over all devices: each takes a share of the scenes, the gradients are averaged.

    Args:
      objective: (params, batch, key) -> (loss, terms), means over the scenes; draws its randomness from the key.
      packing: how the state holds the parameters; those of group ``KEPT`` stay as they are.
      batch_size: scenes a step over all processes; as many devices are used as divide it.
      devices: defaults to all. Their number decides which random numbers a scene gets.
      at_once: scenes that a device works on at once, the rest of its share after them, gradients adding up; defaults
        to 16 on a CPU, where memory is dear and more scenes at once are no faster, and to all elsewhere.

    Returns:
      (state, batch of this process) -> (new state, metrics); the given state is donated. The new one's vectors lie in
      equal shares over the devices of one process where their length allows it, else whole on each.
    """
    mesh = scene_mesh(batch_size, devices)
    most = at_once or scenes_per_step(batch_size)
    spread = NamedSharding(mesh, PartitionSpec(AXIS))

    def place(leaf: Any) -> PartitionSpec:
        # Vectors lie in shares, where they have equal ones: a device updates its own (ZeRO, arXiv:1910.02054).
        even = jax.process_count() == 1 and np.ndim(leaf) > 0 and leaf.shape[0] % mesh.size == 0
        return PartitionSpec(AXIS) if even else PartitionSpec()

    def places(tree: Any) -> Any:
        return jax.tree.map(lambda leaf: NamedSharding(mesh, place(leaf)), tree)

    def mean(gradient: jax.Array) -> jax.Array:
        if place(gradient) == PartitionSpec():
            return jax.lax.pmean(gradient, AXIS)
        return jax.lax.psum_scatter(gradient, AXIS, tiled=True) / mesh.size

    def means(found: Any, gradients: Vectors):
        return jax.lax.pmean(found, AXIS), jax.tree.map(mean, gradients)

    def gradient(vectors: Vectors, batch: Example, key: jax.Array):
        # By the arrays and then packed: by the vectors, every array's gradient would be padded to the whole length.
        found, gradients = jax.value_and_grad(objective, has_aux=True)(packing.unpack(vectors), batch, key)
        return found, trained(packing.pack(gradients))

    def share(params: Vectors, batch: Example, key: jax.Array):
        key = jax.random.fold_in(key, jax.lax.axis_index(AXIS))
        parts = _parts(len(jax.tree.leaves(batch)[0]), most)
        if parts == 1:
            return means(*gradient(params, batch, key))
        split = jax.tree.map(lambda x: x.reshape(parts, -1, *x.shape[1:]), batch)

        def add(total, part):
            batch, number = part
            found = gradient(params, batch, jax.random.fold_in(key, number))
            return jax.tree.map(jnp.add, total, found), None

        like = jax.eval_shape(gradient, params, jax.tree.map(lambda x: x[0], split), key)
        zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), like)
        total, _ = jax.lax.scan(add, zeros, (split, jnp.arange(parts)))
        return means(*jax.tree.map(lambda x: x / parts, total))

    def step(state: TrainState, batch: Example):
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), 1), state.step)
        gradients_of = jax.shard_map(
            share, mesh=mesh, in_specs=(PartitionSpec(), PartitionSpec(AXIS), PartitionSpec()),
            out_specs=(PartitionSpec(), jax.tree.map(place, trained(state.params))), check_vma=False,
        )  # fmt: skip
        (loss, terms), gradients = gradients_of(state.params, batch, key)
        updates, moments = optimizer.update(gradients, state.optimizer, trained(state.params))
        params = state.params | optax.apply_updates(trained(state.params), updates)
        ema = update_ema(state.ema, params, state.step + 1, ema_decay)
        norms = {"gradient_norm": optax.tree.norm(gradients), "update_norm": optax.tree.norm(updates)}
        new = TrainState(step=state.step + 1, params=params, ema=ema, optimizer=moments)
        return jax.lax.with_sharding_constraint(new, places(new)), {"loss": loss, **terms, **norms}

    program = jax.jit(step, donate_argnums=0)

    def run(state: TrainState, batch: Example):
        batch = jax.tree.map(lambda x: jax.make_array_from_process_local_data(spread, np.asarray(x)), batch)
        # A device whose share is still being copied would begin late, and the others wait where gradients are summed.
        jax.block_until_ready(batch)
        if not isinstance(state.step.sharding, NamedSharding):  # asking for every leaf in every step takes long
            state = jax.device_put(state, places(state))
        return program(state, batch)

    return run


def _parts(scenes: int, most: int) -> int:
    """The least number of equal parts of at most ``most`` scenes."""
    return next(n for n in range(1, scenes + 1) if scenes % n == 0 and scenes // n <= most)


def pipeline_config(batch: dict[str, Any], **changes: Any) -> PipelineConfig:
    """``config.batch`` as it comes out of JSON (lists for tuples)."""
    fields = {name: _tuples(value) for name, value in batch.items()}
    return PipelineConfig(**{**fields, **changes})


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
