"""The behavior network, trained on the next motions of logged agents, given how much room they keep."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.models.behavior.config import BehaviorConfig
from scjax.models.behavior.network import behavior_network
from scjax.models.behavior.surroundings import surroundings_of
from scjax.models.behavior.vocabulary import token_errors
from scjax.nn.functional import Functional, Params, Path
from scjax.sim.behavior_weights import BehaviorWeights, load_behavior
from scjax.train.motion.cache import MotionCache, open_cache
from scjax.train.motion.loader import MotionExample, MotionLoader, MotionLoaderConfig
from scjax.train.objectives.base import PicturePath, Terms

_SPREAD = 0.012  # m; tokens share the probability of a target by their distances from it
_VALIDATION_BATCHES = 8


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class BehaviorObjective:
    """See ``Objective``.

    Attributes:
      cache: the logs as arrays.
      model: sizes of the network.
      start: weights of step 0, or None for fresh ones.
      return_weight: of the loss of returns beside that of motions.
      loader: what batches look like.
    """

    cache: MotionCache
    model: BehaviorConfig
    start: BehaviorWeights | None
    return_weight: float
    loader: MotionLoaderConfig

    frozen: ClassVar[frozenset[Path]] = frozenset()

    @classmethod
    def from_config(cls, config) -> BehaviorObjective:
        """The objective of a training config; builds the cache of ``config.logs`` if it is not there.

        Raises:
          ValueError: no logs, a cache of others, or weights of another size.
        """
        model = BehaviorConfig(**config.model.to_dict())
        cache = open_cache(config.logs, config.cache, model, config.rolls, config.seed)
        start = None
        if config.init_from:
            start = load_behavior(None if config.init_from == "shipped" else config.init_from)
            if start.config != model:
                raise ValueError(f"config.init_from: {config.init_from} has other sizes: give its config.model")
        return cls(
            cache=cache,
            model=model,
            start=start,
            return_weight=config.return_weight,
            loader=MotionLoaderConfig(**config.batch.to_dict()),
        )

    @property
    def network(self) -> Functional:
        """The behavior network as pure functions."""
        return behavior_network(self.model)

    @property
    def inputs(self) -> dict[str, str]:
        """Hashes of the logs and of the weights of step 0."""
        return {"logs": self.cache.sha256} | ({} if self.start is None else {"init_from": self.start.sha256})

    def batches(self, loader: MotionLoaderConfig, *, process: int = 0, processes: int = 1) -> MotionLoader:
        """Endless batches of the training logs."""
        return MotionLoader(self.cache, self.cache.train, loader, process=process, processes=processes)

    def init(self, key: Array) -> Params:
        """Fresh parameters, or those of ``start``."""
        if self.start is None:
            return self.network.init(key)
        return jax.tree.map(jnp.asarray, self.start.params)

    def prepare(self, params: Params) -> Params:
        """Nothing is fitted beforehand."""
        return params

    def loss(self, params: Params, batch: MotionExample, keys: Array) -> tuple[Array, Terms]:
        """Cross-entropy of the tokens that come near the next motions, given the returns, and of the returns."""
        traffic = batch.traffic
        seen = jax.vmap(lambda one, rows: surroundings_of(one, rows, self.model.neighbors))(traffic, batch.rows)
        seen = jax.lax.stop_gradient(seen)

        def pick(values: Any) -> Array:
            values = jax.vmap(lambda one, rows: one[rows])(values, batch.rows)
            return values.reshape(-1, *values.shape[2:])

        def flat(values: Any) -> Array:
            return values.reshape(-1, *values.shape[2:])

        kind, returns = pick(traffic.kind), flat(batch.returns)
        return_logits, logits = self.network.apply(
            params, flat(seen.own), flat(seen.others), flat(seen.mask), returns, kind
        )
        base = pick(traffic.motions)[:, 0]
        errors = token_errors(
            self.cache.vocabulary, base, flat(batch.target), pick(traffic.length), pick(traffic.width), kind
        )
        shares = jax.nn.softmax(-errors / _SPREAD, axis=1)
        log_shares = jax.nn.log_softmax(logits, axis=1)
        weight = flat(batch.mask).astype(jnp.float32)
        total = jnp.maximum(weight.sum(), 1.0)

        def mean(values: Array) -> Array:
            return (values * weight).sum() / total

        nearest = jnp.argmin(errors, axis=1)[:, None]
        motion = mean(-(shares * log_shares).sum(1))
        nll = mean(-jnp.take_along_axis(log_shares, nearest, axis=1)[:, 0])
        own_return = mean(-jnp.take_along_axis(jax.nn.log_softmax(return_logits, 1), returns[:, None], axis=1)[:, 0])
        loss = motion + self.return_weight * own_return
        return loss, {"motion": motion, "nll": nll, "return": own_return, "token_error": mean(errors.min(1))}

    def evaluate(self, params: Params) -> dict[str, float]:
        """Loss terms of held-back logs; of training logs where all are of few places."""
        terms = [self._terms(params, batch) for batch in self._validation]
        return {name: float(np.mean([jax.device_get(one[name]) for one in terms])) for name in terms[0]}

    def draw_pictures(self, params: Params, path_of: PicturePath) -> None:
        """Motion has no pictures."""

    def export(self, params: Params, notes: dict[str, Any]) -> BehaviorWeights:
        """The weights with the vocabulary of the logs."""
        return BehaviorWeights(self.model, jax.device_get(params), self.cache.vocabulary, notes)

    @functools.cached_property
    def _validation(self) -> list[MotionExample]:
        files = self.cache.validation or self.cache.train[:1]
        loader = MotionLoader(self.cache, files, dataclasses.replace(self.loader, seed=1))
        return [next(loader) for _ in range(_VALIDATION_BATCHES)]

    @functools.cached_property
    def _terms(self) -> Callable[[Params, MotionExample], Terms]:
        keys = jax.random.split(jax.random.key(0), 1)
        return jax.jit(lambda params, batch: self.loss(params, batch, keys)[1])
