"""The best of several candidates for one scene, by the rules that read prompts and scenes."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scjax.generate.conditions import Condition
from scjax.language.attributes.table import score_attributes
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import PromptSpec, check, parse_prompt
from scjax.metrics.realism import ON_LANE, OPEN_CONNECTION, connection_gaps, lane_offsets, overlapping_pairs
from scjax.scene import Scene


class SceneScore(NamedTuple):
    """What is wrong with a scene. Less is better; earlier fields decide first.

    Attributes:
      missed: what the prompt and the attributes request and the scene does not show, plus one if the ego is on no lane
        (fragments of lanes pass for much, such as for a curve); 0 without a request.
      faults: overlapping boxes, lane connections open by more than 1 m, and vehicles on no lane.
      gap: sum of the gaps at lane connections [m].
    """

    missed: int
    faults: int
    gap: float


def score_scene(prompt: str | None, scene: Scene, attributes: Mapping[str, Any] | None = None) -> SceneScore:
    """Scores a scene for its prompt and attributes; without either the faults alone count."""
    gaps, (offsets, _) = connection_gaps(scene), lane_offsets(scene)
    missed = 0
    if prompt is not None:
        missed = sum(not shown for shown in check(parse_prompt(prompt), extract_facts(scene)).values())
    if attributes:
        missed += len(score_attributes(scene, attributes).misses)
    if prompt is not None or attributes:
        missed += int((offsets[:1] > ON_LANE).sum())
    faults = len(overlapping_pairs(scene)) + int((gaps > OPEN_CONNECTION).sum()) + int((offsets > ON_LANE).sum())
    return SceneScore(missed, faults, float(gaps.sum()))


def best_index(prompt: str | None, scenes: Sequence[Scene], attributes: Mapping[str, Any] | None = None) -> int:
    """Index of the scene with the least ``score_scene``, the first of equals.

    Raises:
      ValueError: there are no scenes.
    """
    if not scenes:
        raise ValueError("there are no scenes to choose from: give at least one")
    return min(range(len(scenes)), key=lambda k: score_scene(prompt, scenes[k], attributes))


def prompt_warnings(condition: Condition) -> list[str]:
    """Sentences about parts of a prompt that will not come true.

    Either no rule reads anything from the prompt, so that candidates are chosen by their faults alone; or the prompt
    speaks of more agents than ``num_agents`` allows.
    """
    if condition.prompt is None:
        return []
    spec = parse_prompt(condition.prompt)
    if spec == PromptSpec():
        return [
            "no kind of road, number, light, person or event was read from "
            f"{textwrap.shorten(condition.prompt, 60)!r}: no candidate is chosen by it. "
            "Plain English is read best, as 'a T-intersection with three vehicles'"
        ]
    if condition.num_agents is None:
        return []
    least = sum(amount[0] for amount in (spec.vehicles, spec.pedestrians, spec.cyclists) if amount is not None)
    if least + 1 <= condition.num_agents:
        return []
    return [
        f"the prompt speaks of {least} agents or more besides the ego, but the number of agents is given as "
        f"{condition.num_agents}: the given number is taken"
    ]
