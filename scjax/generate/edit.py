"""Parts of a scene generated anew: single agents, or all in a region. Everything else stays bit for bit."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool

from scjax.generate.arguments import as_conditions, as_model, sampling_key
from scjax.generate.best_of import best_index
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.place import placement_condition
from scjax.generate.readings import read_prompts
from scjax.generate.sample import sample_scenes
from scjax.scene import AgentType, Scene, permute
from scjax.scene.arguments import truth_value, whole_number
from scjax.scene.boxes import overlaps
from scjax.scene.edit import agent_rows, join_agents, keep_elements, single_scene
from scjax.scene.limits import MAX_SLOTS
from scjax.scene.regions import inside_polygon, region_polygon

REGION_CANDIDATES = 8
"""Scenes whose agents fill a region: few of one scene lie in a small one."""
_COUNTED = {
    "vehicles": AgentType.VEHICLE,
    "pedestrians": AgentType.PEDESTRIAN,
    "cyclists": AgentType.CYCLIST,
    "static": AgentType.STATIC,
}
_LANES_KEY, _AGENTS_KEY = 1, 2  # folded into the key of a region


def regenerate_agents(
    key: Array | int,
    scene: Scene,
    agents: int | Iterable[int],
    condition: Condition | str | None = None,
    *,
    model: Model | str | Path | None = None,
    best_of: int = 1,
    **options: Any,
) -> Scene:
    """``scene`` with some agents drawn anew, anywhere in it, given all the others.

    New agents take the indices of the old ones. Without a condition they are of the same classes.

    Args:
      key: typed key, or its number.
      scene: one scene.
      agents: indices, counted from 0 without padding.
      condition: what the whole scene shall show then, as in ``scjax.place``.
      model, best_of, options: as in ``scjax.sample``.

    Raises:
      ValueError: there is no such agent, or it is the ego; or as ``scjax.place``.
    """
    scene = single_scene(scene)
    rows = agent_rows(scene, agents)
    model = as_model(model)
    if not len(rows):
        return scene
    lanes = np.ones(len(scene.lanes), bool)
    kept = np.ones(len(scene.agents), bool)
    kept[rows] = False
    condition = _same_classes(condition, scene)
    known = placement_condition(keep_elements(scene, kept, lanes), condition, model, num_agents=len(scene.agents))
    (drawn,) = sample_scenes(key, [known], model=model, best_of=best_of, **options)
    order = np.argsort([*np.flatnonzero(kept), *rows])
    return permute(drawn, order, np.arange(len(lanes))).replace(crop=scene.crop, domain=scene.domain)


def regenerate_region(
    key: Array | int,
    scene: Scene,
    region: Any,
    condition: Condition | str | None = None,
    *,
    num_agents: int | None = None,
    lanes: bool = False,
    model: Model | str | Path | None = None,
    best_of: int = REGION_CANDIDATES,
    **options: Any,
) -> Scene:
    """``scene`` with all agents in a region drawn anew, and its lanes if that is requested, given everything else.

    The ego stays. Agents are gathered from ``best_of`` candidates: those in the region that overlap no other. There
    are as many as before at most; fewer, where too few candidates have some there.

    Args:
      key: typed key, or its number.
      scene: one scene.
      region: a box (x0, y0, x1, y1), or corners of a polygon [corners, 2], in the frame of the scene [m].
      condition: what the whole scene shall show then, as in ``scjax.place``; with ``lanes`` also of roads.
      num_agents: agents in the region then, the ego apart; by default as many as before.
      lanes: whether lanes are drawn anew too that have more than half of their points in the region. New ones may
        leave it. They are the last lanes then.
      model, best_of, options: as in ``scjax.sample``.

    Returns:
      The scene; kept agents and lanes come first in their order, then new ones.

    Raises:
      ValueError: the region encloses nothing; or as ``scjax.place``.
    """
    scene, polygon = single_scene(scene), region_polygon(region)
    best_of = whole_number(best_of, "best_of", 1, MAX_SLOTS)
    key, model = sampling_key(key), as_model(model)
    inside = inside_polygon(np.asarray(scene.agents)[:, :2], polygon)
    inside[:1] = False
    number = int(inside.sum())
    if num_agents is not None:
        number = whole_number(num_agents, "num_agents", 0, MAX_SLOTS)
    classes = scene if num_agents is None else None
    kept = keep_elements(scene, ~inside, np.ones(len(scene.lanes), bool))
    if truth_value(lanes, "lanes"):
        drawn = inside_polygon(np.asarray(scene.lanes)[..., :2], polygon).mean(-1) > 0.5
        kept = _new_lanes(jax.random.fold_in(key, _LANES_KEY), kept, drawn, condition, model, best_of, options)
    if not number:
        return kept
    known = placement_condition(kept, _same_classes(condition, classes), model, num_agents=len(kept.agents) + number)
    candidates = sample_scenes(
        jax.random.fold_in(key, _AGENTS_KEY), [known], model=model, num_scenes=best_of, **options
    )
    return _gathered(kept, candidates, number, lambda points: inside_polygon(points, polygon))


def _new_lanes(
    key: Array,
    scene: Scene,
    drawn: Bool[np.ndarray, " lanes"],
    condition: Condition | str | None,
    model: Model,
    best_of: int,
    options: Mapping[str, Any],
) -> Scene:
    """``scene`` with the lanes ``drawn`` replaced by new ones, the last."""
    if not drawn.any():
        return scene
    (condition,) = read_prompts(as_conditions(condition, 1), model).conditions
    every = np.ones(len(scene.agents), bool)
    known = placement_condition(scene, condition, model)
    fewer = dataclasses.replace(known, known=keep_elements(scene, every, ~drawn), num_agents=max(len(every), 1))
    candidates = sample_scenes(key, [fewer], model=model, num_scenes=best_of, **options)
    best = candidates[best_index(candidates, condition.attributes)]
    return best.replace(crop=scene.crop, domain=scene.domain)


def _gathered(
    kept: Scene, candidates: list[Scene], number: int, is_inside: Callable[[np.ndarray], np.ndarray]
) -> Scene:
    """``kept`` with at most so many new agents of the candidates: those inside, the fullest candidate first."""
    count = len(kept.agents)
    rows = [count + np.flatnonzero(is_inside(np.asarray(one.agents)[count:, :2])) for one in candidates]
    scene = kept
    for k in sorted(range(len(candidates)), key=lambda k: -len(rows[k])):
        for row in rows[k]:
            if len(scene.agents) == count + number:
                return scene
            boxes = np.concatenate([scene.agents, candidates[k].agents[[row]]])
            if not overlaps(boxes)[-1].any():
                scene = join_agents(scene, candidates[k], [int(row)])
    return scene


def _same_classes(condition: Condition | str | None, scene: Scene | None) -> Condition:
    """The condition; of one that says nothing of agents, and with a scene, the numbers of its classes are added."""
    (condition,) = as_conditions(condition, 1)
    if scene is None or condition.prompt is not None or condition.attributes:
        return condition
    types = scene.agent_types[1:]
    return dataclasses.replace(
        condition, attributes={name: int((types == kind).sum()) for name, kind in _COUNTED.items()}
    )
