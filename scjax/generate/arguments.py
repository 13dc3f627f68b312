"""What ``scjax.sample`` accepts in place of keys, conditions and models, and the check of what it returns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.data.ranges import MAX_SEED
from scjax.generate.conditions import Condition
from scjax.generate.model import Model, load_model
from scjax.scene import Scene
from scjax.scene.arguments import whole_number

MAX_SCENES, MAX_STEPS, MAX_TEMPERATURE = 100_000, 100, 100.0


def sampling_key(key: Any) -> Array:
    """A typed key, also from its number.

    Raises:
      ValueError: it is neither; old keys, which are arrays of numbers, are refused.
    """
    if isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        if key.shape != ():
            raise ValueError(f"key must be one key, not keys of shape {key.shape}: take one of them")
        return key
    if getattr(key, "shape", ()) != () or getattr(key, "dtype", None) == np.uint32:
        raise ValueError("key must be a typed key: jax.random.key(0), not an array of numbers")
    return jax.random.key(whole_number(key, "key (jax.random.key(0), or its number)", 0, MAX_SEED))


def as_conditions(condition: object, num_scenes: int) -> list[Condition]:
    """Conditions, of one or several; a text is a condition with that prompt, None is one that holds nothing fixed.

    Args:
      num_scenes: scenes that each stands for.

    Raises:
      ValueError: something else is given, or there are too many scenes.
    """
    if condition is None or isinstance(condition, Condition | str):
        return [_as_condition(condition)]
    if isinstance(condition, bytes) or not isinstance(condition, Sequence):
        raise ValueError(
            f"condition must be a scjax.Condition, a text, or a sequence of them, not {type(condition).__name__}"
        )
    if len(condition) * num_scenes > 1_000_000:
        raise ValueError(f"{len(condition)} conditions of {num_scenes} scenes each are too many for one call")
    return [_as_condition(one) for one in condition]


def _as_condition(value: Any) -> Condition:
    if value is None:
        return Condition()
    if isinstance(value, str):
        return Condition(prompt=value)
    if not isinstance(value, Condition):
        raise ValueError(
            f"condition must be a scjax.Condition or a sequence of them, not {type(value).__name__}: "
            "a text is scjax.Condition(prompt=text)"
        )
    return value


def as_model(model: Model | str | Path | None) -> Model:
    """A model, also from its folder; None is the one that ships with the package.

    Raises:
      ValueError: it is no model, or its folder is damaged.
    """
    if model is None or isinstance(model, str | Path):
        return load_model(model)
    if not isinstance(model, Model):
        raise ValueError(f"model must be a model of scjax.load, or its folder, not {type(model).__name__}")
    return model


def check_finite(scenes: Sequence[Scene]) -> None:
    """Refuses scenes with NaN or infinity, which no user shall get.

    Raises:
      ValueError: says what leads to them.
    """
    for scene in scenes:
        if not (np.isfinite(scene.agents).all() and np.isfinite(scene.lanes).all()):
            raise ValueError(
                "the networks gave NaN or infinity: the model is damaged (its training diverged), or guidance, "
                "temperature or energy_guidance are far from their defaults"
            )
