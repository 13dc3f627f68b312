"""Gradients of a batch: every device takes an equal share of the scenes, and devices average.

The program of a batch size holds the network alone. Parameters come in as arrays of their own: cut out of one vector,
each would have a place of its own in the machine code, and equal layers would be compiled again for every layer.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Integer

from scjax.nn.functional import Params, flatten, unflatten
from scjax.nn.random import row_keys
from scjax.nn.sharding import AXIS, RULES, partition_specs, sharded_axis
from scjax.train.param_groups import FROZEN, Groups, ParamGroups, trained

LossFn = Callable[[Params, Any, Array], tuple[Array, dict[str, Array]]]
"""(parameters, batch [B], keys [B]) -> loss and terms, both means over the scenes of the batch."""

Result = tuple[Array, dict[str, Array]]
"""Loss and terms, means over the batch."""


@runtime_checkable
class Gradients(Protocol):
    """The three parts of a gradient, each a program: before, for, and after a batch."""

    def gather(self, groups: Groups) -> Any:
        """The parameters as ``of_batch`` takes them."""
        ...

    def of_batch(self, params: Any, batch: Any, index: Integer[Array, " b"]) -> tuple[Result, Any]:
        """Loss and terms, and gradients as ``reduce`` takes them."""
        ...

    def reduce(self, gradients: Any) -> Groups:
        """The mean over devices, placed as the parameters are."""
        ...


@dataclasses.dataclass(frozen=True)
class _Shares:
    """What both kinds have in common.

    Attributes:
      loss: see ``LossFn``.
      param_groups: how the state holds the parameters.
      mesh: the devices that share a batch.
      seed: the random numbers of a scene come from it and from the scene's index.
      at_once: largest number of scenes that a device works on at once; gradients of the parts of its share add up.
    """

    loss: LossFn
    param_groups: ParamGroups
    mesh: Mesh
    seed: int
    at_once: int

    def specs(self, groups: Any) -> Any:
        """How groups, or anything of their structure, lie on the devices."""
        return partition_specs(groups, RULES[self.param_groups.sharding], self.mesh.size)

    def map_shares(self, function: Callable[..., Any], in_specs: Any, out_specs: Any) -> Callable[..., Any]:
        """``function`` on the share of every device."""
        return jax.shard_map(function, mesh=self.mesh, in_specs=in_specs, out_specs=out_specs, check_vma=False)

    def mean_over_share(self, gradient: Callable[[Any, Array], Any], batch: Any, index: Integer[Array, " b"]) -> Any:
        """Result and gradients of a device's share; the result is the mean over all devices."""
        base_key = jax.random.fold_in(jax.random.key(self.seed), 1)
        result, gradients = _mean_of_parts(
            lambda rows, numbers: gradient(rows, row_keys(base_key, numbers)),
            _num_parts(len(index), self.at_once),
            batch,
            index,
        )
        return jax.lax.pmean(result, AXIS), gradients


class FlatGradients(_Shares):
    """Of parameters in vectors (``FlatParams``)."""

    def gather(self, groups: Groups) -> Params:
        """The whole parameters as a tree."""
        specs = self.specs(groups)
        whole = self.map_shares(
            lambda shards: self.param_groups.unpack(jax.tree.map(_gather, shards, specs)), (specs,), PartitionSpec()
        )
        return whole(groups)

    def of_batch(self, params: Params, batch: Any, index: Integer[Array, " b"]) -> tuple[Result, Params]:
        """Gradients [devices, ...] of the trained parameters, of each device's share."""

        def of_share(params: Params, batch: Any, index: Array) -> tuple[Result, Params]:
            def gradient(rows: Any, keys: Array) -> tuple[Result, Params]:
                result, gradients = jax.value_and_grad(self.loss, has_aux=True)(params, rows, keys)
                return result, self._without_frozen(gradients)

            result, gradients = self.mean_over_share(gradient, batch, index)
            return result, jax.tree.map(lambda x: x[None], gradients)

        share, whole = PartitionSpec(AXIS), PartitionSpec()
        return self.map_shares(of_share, (whole, share, share), (whole, share))(params, batch, index)

    def reduce(self, gradients: Params) -> Groups:
        """Vectors of which every device gets its share."""

        def of_share(gradients: Params) -> Groups:
            vectors = self.param_groups.pack(jax.tree.map(lambda x: x[0], gradients))
            return jax.tree.map(functools.partial(_scatter_mean, self.mesh.size), vectors, self.specs(vectors))

        first = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), gradients)
        specs = self.specs(jax.eval_shape(self.param_groups.pack, first))
        return self.map_shares(of_share, (PartitionSpec(AXIS),), specs)(gradients)

    def _without_frozen(self, params: Params) -> Params:
        frozen = {path for path, _ in self.param_groups.groups.get(FROZEN, ())}
        return unflatten({path: leaf for path, leaf in flatten(params).items() if path not in frozen})


class ShardedGradients(_Shares):
    """Of parameters in arrays that lie in shares (``TreeParams``)."""

    def gather(self, groups: Groups) -> Groups:
        """The shares as they are: arrays are gathered where they are used."""
        return groups

    def of_batch(self, params: Groups, batch: Any, index: Integer[Array, " b"]) -> tuple[Result, Groups]:
        """Gradients of the shares. Arrays are gathered again on the way back instead of kept."""
        specs = self.specs(params)

        def of_share(shards: Groups, batch: Any, index: Array) -> tuple[Result, Groups]:
            @functools.partial(jax.checkpoint, policy=lambda primitive, *_, **__: primitive.name != "all_gather")
            def loss(trained_shards: Groups, batch: Any, keys: Array) -> Result:
                groups = jax.tree.map(_gather, shards | trained_shards, specs)
                return self.loss(self.param_groups.unpack(groups), batch, keys)

            gradient = functools.partial(jax.value_and_grad(loss, has_aux=True), trained(shards))
            result, gradients = self.mean_over_share(gradient, batch, index)
            mean = functools.partial(_mean_of_shards, self.mesh.size)
            return result, jax.tree.map(mean, gradients, trained(specs))

        share = PartitionSpec(AXIS)
        run = self.map_shares(of_share, (specs, share, share), (PartitionSpec(), trained(specs)))
        return run(params, batch, index)

    def reduce(self, gradients: Groups) -> Groups:
        """As they are: means already."""
        return gradients


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
