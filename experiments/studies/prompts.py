"""What studies share about prompts: captions of held-out records, what scenes show of requests, sampling in calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

import scjax
from scjax.data.caption_features import TextStore
from scjax.data.captions import Caption, read_captions
from scjax.language.attributes.table import score_attributes
from scjax.language.grammar.compose import Composition
from scjax.scene import Scene

_PROMPTS_PER_CALL = 32


def held_out_captions(folder: str, model: scjax.Model) -> tuple[list[Caption], TextStore]:
    """Captions of the held-out records and their token features.

    Raises:
      ValueError: the features come from another text encoder than the model's.
    """
    captions, store = list(read_captions(folder, "val")), TextStore(folder, "val")
    if store.encoder != model.text_encoder:
        raise ValueError(f"{folder} is embedded by {store.encoder}, the model was trained with {model.text_encoder}")
    return captions, store


def draw_prompt(
    store: TextStore, caption: Caption, row: int, rng: np.random.Generator
) -> tuple[Composition, np.ndarray]:
    """A random caption of a record, and its token features [tokens, width]."""
    number = int(rng.integers(len(caption.texts)))
    return caption.compositions[number], np.asarray(store.features(int(store.texts_of(row)[number])), np.float32)


def count_shown(scene: Scene, request: Mapping[str, Any]) -> tuple[float, float]:
    """(requested attributes that a scene shows, requested attributes)."""
    return float(len(request) - len(score_attributes(scene, request).misses)), float(len(request))


def sample_in_calls(conditions: Sequence[scjax.Condition], title: str, seed: int, **options: Any) -> list[Scene]:
    """One scene per condition under a progress bar; ``options`` are those of ``scjax.sample``."""
    scenes = []
    for start in tqdm(range(0, len(conditions), _PROMPTS_PER_CALL), title, disable=None):
        key = jax.random.fold_in(jax.random.key(seed), start)
        scenes += scjax.sample(key, conditions[start : start + _PROMPTS_PER_CALL], **options)
    return scenes
