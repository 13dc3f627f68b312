"""Prompts of studies: captions of held-out records, what they ask for, and scenes sampled for them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from tqdm import tqdm

import scjax
from scjax.data import records
from scjax.data.caption_features import TextStore
from scjax.data.captions import Caption, read_captions
from scjax.language.attributes.table import measure_attributes, score_attributes
from scjax.language.grammar.compose import Composition
from scjax.scene import Scene

_PROMPTS_PER_CALL = 32


class HeldOutPrompt(NamedTuple):
    """A held-out record: a caption, what it asks for, its condition; the scene and its attributes.

    Attributes:
      request: that the words make, as the captions say.
      measured: attributes of the whole record; ``scene`` has the types of the model only.
    """

    text: str
    request: dict[str, Any]
    condition: scjax.Condition
    scene: Scene
    measured: dict[str, Any]


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


def held_out_prompts(
    folder: str, model: scjax.Model, samples: int, seed: int, per_event: int | None = None
) -> Iterator[HeldOutPrompt]:
    """Held-out records in random order, each with a random caption.

    Args:
      folder: captioned and embedded records.
      model: whose types the scenes have.
      samples: number of records at most.
      seed: of order and styles.
      per_event: only captions that name a rare event, at most so many per event; None: any caption.

    Raises:
      ValueError: as ``held_out_captions``; or no caption names an event.
    """
    captions, store = held_out_captions(folder, model)
    rng, tiles = np.random.default_rng(seed), records.open_records(folder, "val")
    count, events = 0, Counter()
    for row in map(int, rng.permutation(len(captions))):
        if count == samples:
            return
        composition, tokens = draw_prompt(store, captions[row], row, rng)
        named = composition.request.get("event", ())
        if per_event is not None and not any(events[event] < per_event for event in named):
            continue
        events.update(named)
        count += 1
        scene = records.sample_scene(records.decode_record(tiles[row]))
        condition = scjax.Condition(streams={"text": scjax.Stream(tokens)})
        measured = measure_attributes(scene)
        yield HeldOutPrompt(composition.text, composition.request, condition, model.codec.select(scene), measured)
    if per_event is not None and not events:
        raise ValueError(
            f"--per-event: no held-out caption of {folder} names a rare event: make records with --ordinary 0.1"
        )


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
