"""Prompts -> token features: from those that ship with a model, else from its text encoder."""

from __future__ import annotations

import dataclasses
import textwrap
import warnings
from collections.abc import Sequence
from typing import NamedTuple

from scjax.encoders.text import Encoder, checked, load_text_encoder
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import PromptSpec, check, parse_prompt
from scjax.metrics.realism import ON_LANE, OPEN_CONNECTION, connection_gaps, lane_offsets, overlapping_pairs
from scjax.scene import Scene


def encode_prompts(conditions: Sequence[Condition], model: Model, encoder: Encoder | None = None) -> list[Condition]:
    """Conditions whose prompts are replaced by token features; each different text is encoded once.

    Args:
      encoder: by default the one that ``load_text_encoder`` finds, and only if a text is not among the model's own.

    Raises:
      ValueError: the model is not trained on text, the encoder is another one than the model's, or no text is given.
    """
    wanted = dict.fromkeys(checked(text) for cond in conditions for text in _texts(cond))
    if not wanted:
        return list(conditions)
    if not model.text_encoder:
        raise ValueError("a prompt is given, but this model was not trained on text: leave it out, or load another one")
    features = dict(model.prompts)
    missing = [text for text in wanted if text not in features]
    if missing:
        encoder = encoder or load_text_encoder()
        if encoder.name != model.text_encoder:
            raise ValueError(
                f"the text encoder is {encoder.name}, but this model was trained with {model.text_encoder}: "
                "give the folder of that one by the variable SCJAX_TEXT_ENCODER"
            )
        for text in missing:
            if encoder.is_cut(text):
                warnings.warn(f"a prompt of {len(text.split())} words is too long: its end is not read", stacklevel=3)
        features |= {text: found.features for text, found in zip(missing, encoder(missing), strict=True)}

    def told(cond: Condition) -> Condition:
        changes = {
            tokens: features[checked(text)]
            for tokens, text in (("tokens", cond.prompt), ("negative_tokens", cond.negative_prompt))
            if text is not None
        }
        if not changes:
            return cond
        return dataclasses.replace(cond, prompt=None, negative_prompt=None, **changes)

    return [told(cond) for cond in conditions]


class SceneScore(NamedTuple):
    """What is wrong with a scene for a prompt; the less, the better, the first number before the others.

    Attributes:
      missed: things asked for that it does not show; an ego on no lane counts as one, for scraps of lanes can pass for
        much, a curve for one.
      faults: boxes that overlap, joints open by more than 1 m, vehicles on no lane.
      gap: sum of the gaps at joints [m].
    """

    missed: int
    faults: int
    gap: float


def score_scene(prompt: str, scene: Scene) -> SceneScore:
    """By the rules that read prompts and scenes (``captions.reading``)."""
    gaps, (offsets, _) = connection_gaps(scene), lane_offsets(scene)
    missed = sum(not good for good in check(parse_prompt(prompt), extract_facts(scene)).values())
    missed += int((offsets[:1] > ON_LANE).sum())
    faults = len(overlapping_pairs(scene)) + int((gaps > OPEN_CONNECTION).sum()) + int((offsets > ON_LANE).sum())
    return SceneScore(missed, faults, float(gaps.sum()))


def best(prompt: str, scenes: Sequence[Scene]) -> int:
    """Index of the scene with the least ``score_scene``, the first of equals.

    Raises:
      ValueError: there are no scenes.
    """
    if not scenes:
        raise ValueError("there are no scenes to choose from: give at least one")
    return min(range(len(scenes)), key=lambda k: score_scene(prompt, scenes[k]))


def _texts(cond: Condition) -> list[str]:
    return [text for text in (cond.prompt, cond.negative_prompt) if text is not None]


def prompt_warnings(cond: Condition) -> list[str]:
    """Sentences about what of a prompt will not come true: that no rule reads anything from it, so that no candidate is
    chosen by it; or numbers that given counts, which win, do not allow."""
    if cond.prompt is None:
        return []
    asked = parse_prompt(cond.prompt)
    if asked == PromptSpec():
        return [
            f"no kind of road, number, light, person or event was read from {textwrap.shorten(cond.prompt, 60)!r}: "
            "no candidate is chosen by it. Plain English is read best, as 'a T-intersection with three vehicles'"
        ]
    if cond.num_agents is None:
        return []
    least = sum(amount[0] for amount in (asked.vehicles, asked.pedestrians, asked.cyclists) if amount is not None)
    if least + 1 <= cond.num_agents:
        return []
    return [
        f"the prompt speaks of {least} agents or more besides the ego, but the number of agents is given as "
        f"{cond.num_agents}: the given number is taken"
    ]
