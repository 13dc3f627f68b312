"""``scjax.place``: traffic on lanes that are given, in scenes and at a place of a map."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from jaxtyping import Array

from scjax.data.map_crop import crop_map, find_window
from scjax.generate.arguments import as_conditions, as_model
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.sample import sample_scenes
from scjax.scene import TILE_SIZE, Crop, Map, Scene
from scjax.scene.arguments import finite_number, truth_value, whole_number
from scjax.scene.boxes import intersection_areas, overlaps
from scjax.scene.edit import keep_elements, single_scene
from scjax.scene.limits import MAX_SLOTS, MAX_SPEED
from scjax.scene.map_forms import add_agents
from scjax.scene.map_removal import remove_from_map

EGO_SPEED = 5.0
"""m/s, of the ego that is put at a place of a map."""
_INSIDE = 0.5  # share of a box; boxes of recordings touch, and overlap a little
_NAME = "placed"  # begins the ids of agents that a map gets

At = Sequence[float] | str
"""A place of a map, (x, y) or (x, y, yaw) [m, rad], or the id of one of its agents."""


@overload
def place_traffic(
    key: Array | int, map_or_scene: Map, condition: Condition | str | None = None, *, at: At, **options: Any
) -> Map: ...


@overload
def place_traffic(
    key: Array | int, map_or_scene: Scene, condition: Condition | str | None = None, **options: Any
) -> Scene: ...


@overload
def place_traffic(
    key: Array | int, map_or_scene: Sequence[Scene], condition: Condition | str | None = None, **options: Any
) -> list[Scene]: ...


def place_traffic(
    key: Array | int,
    map_or_scene: Map | Scene | Sequence[Scene],
    condition: Condition | str | None = None,
    *,
    at: At | None = None,
    num_agents: int | None = None,
    keep_agents: bool = True,
    ego_speed: float = EGO_SPEED,
    model: Model | str | Path | None = None,
    best_of: int = 1,
    **options: Any,
) -> Map | Scene | list[Scene]:
    """Adds agents to scenes, or to a map around a place; lanes, signals, links and agents there stay bit for bit.

    In a map the agents come around an ego: the agent that ``at`` names, or a new vehicle of usual size at the place.
    ``crop_map`` gives the same window as a scene.

    Args:
      key: typed key, or its number. Scene i of several depends on ``fold_in(key, i)`` only.
      map_or_scene: a map, a scene whose agent 0 is the ego, or a sequence of such scenes.
      condition: what to show, as in ``scjax.sample``: prompt, attributes, domain. What it says about roads is of no
        effect, since the lanes are given.
      at: of a map: (x, y) or (x, y, yaw) of the ego [m, rad], or the id of the agent that is the ego.
      num_agents: agents of a scene, or of the window of a map, with the ego and those that stay; by default drawn.
      keep_agents: whether the agents that are there stay; if not, only the ego does.
      ego_speed: of the new ego at a place of a map [m/s].
      model: as in ``scjax.sample``.
      best_of: candidates, as in ``scjax.sample``.
      options: further ones of ``scjax.sample``.

    Returns:
      For a scene the scene with its new agents last, for several a list. For a map the map with the agents of the
      window, in its frame: ids begin with "placed". The window's other agents stay or, without ``keep_agents``, go.

    Raises:
      ValueError: no lanes, more lanes or agents than the model takes, agents inside each other, or a place without a
        road; what is wrong with the condition or an option.
    """
    keep_agents = truth_value(keep_agents, "keep_agents")
    model = as_model(model)
    if not isinstance(map_or_scene, Map):
        if at is not None:
            raise ValueError("at is for maps: the place of a scene is that of its ego, leave it out")
        scenes = [map_or_scene] if isinstance(map_or_scene, Scene) else _scenes(map_or_scene)
        conditions = [
            placement_condition(scene, condition, model, num_agents=num_agents, keep_agents=keep_agents)
            for scene in scenes
        ]
        placed = sample_scenes(key, conditions, model=model, best_of=best_of, **options)
        placed = [_in_scene(scene, known.known) for scene, known in zip(placed, conditions, strict=True)]
        return placed[0] if isinstance(map_or_scene, Scene) else placed
    scene = window_of_map(map_or_scene, at, ego_speed)
    place = {"num_agents": num_agents, "keep_agents": keep_agents, "model": model, "best_of": best_of}
    placed = place_traffic(key, scene, condition, **place, **options)
    return traffic_in_map(map_or_scene, at, placed, len(scene.agents) if keep_agents else 1, keep_agents=keep_agents)


def placement_condition(
    scene: Scene,
    condition: Condition | str | None = None,
    model: Model | None = None,
    *,
    num_agents: int | None = None,
    keep_agents: bool = True,
) -> Condition:
    """The condition of ``scjax.sample`` for traffic on the lanes of a scene.

    Arguments and errors as ``place_traffic``; ``model`` is for the checks of sizes.
    """
    scene = single_scene(scene)
    (condition,) = as_conditions(condition, 1)
    _check_condition(condition)
    if not len(scene.lanes):
        raise ValueError("map_or_scene has no lanes: give a scene with lanes, or a place on a road")
    if not keep_agents:
        scene = keep_elements(scene, np.arange(len(scene.agents)) < 1, np.ones(len(scene.lanes), bool))
    if num_agents is not None:
        num_agents = whole_number(num_agents, "num_agents", max(len(scene.agents), 1), MAX_SLOTS)
    if model is not None:
        config = model.denoiser.config
        for name, count, most in (
            ("lanes", len(scene.lanes), config.max_lanes),
            ("agents", num_agents or len(scene.agents), config.max_agents),
        ):
            if count > most:
                raise ValueError(
                    f"map_or_scene: {count} {name} are more than the {most} of this model: remove some, or cut a "
                    "smaller scene"
                )
    check_apart(scene)
    return dataclasses.replace(
        condition,
        known=scene,
        num_lanes=len(scene.lanes),
        num_agents=condition.num_agents if num_agents is None else num_agents,
        crop=Crop(int(scene.crop)),
    )


def check_apart(scene: Scene) -> None:
    """Whether no agent of a scene is inside another one.

    Raises:
      ValueError: more than half of a box is covered by another one; names both.
    """
    rows = np.argwhere(np.triu(overlaps(np.asarray(scene.agents))))
    agents = np.asarray(scene.agents)
    areas = intersection_areas(agents[rows[:, 0]], agents[rows[:, 1]])
    sizes = (agents[:, 6] * agents[:, 7])[rows].min(-1)
    inside = rows[areas > _INSIDE * sizes]
    if len(inside):
        raise ValueError(
            f"map_or_scene: agents {inside[0, 0]} and {inside[0, 1]} are inside each other: remove or move one "
            "(scjax.remove_agents, scjax.move_agent)"
        )


def window_of_map(map: Map, at: At | None, ego_speed: float = EGO_SPEED) -> Scene:
    """The scene of a map around a place, with an ego that drives there, or around an agent.

    Raises:
      ValueError: ``at`` is neither, or no road is there.
    """
    speed = finite_number(ego_speed, "ego_speed", 0.0, MAX_SPEED)
    place = _place_of(map, at)
    try:
        scene = crop_map(map, off_road=True, **place)
    except ValueError as error:
        raise ValueError(f"at: {error}") from error
    if "agent" not in place:
        scene.agents[0, 3] = speed
        scene.agent_known[0] = True
    return scene


def traffic_in_map(map: Map, at: At | None, placed: Scene, num_known: int, *, keep_agents: bool = True) -> Map:
    """``map`` with the agents of a placed scene whose window is at ``at``.

    Args:
      num_known: so many leading agents of the scene are of the map, besides a new ego.
      keep_agents: False: agents of the map inside the window are left out, the ego apart.
    """
    place = _place_of(map, at)
    x, y, z, yaw = find_window(map, **place)
    ego = place.get("agent")
    new = [*range(0 if ego is None else num_known, 1 if ego is None else num_known)]
    new += [*range(num_known, len(placed.agents))]
    if not keep_agents:
        map = _without_agents(map, x, y, yaw, ego)
    return add_agents(map, placed, new, x=x, y=y, z=z, yaw=yaw, name=_NAME)


def _without_agents(map: Map, x: float, y: float, yaw: float, ego: str | None) -> Map:
    """``map`` without the agents in the window at a place, apart from the ego."""
    offset = map.agents[:, :2] - np.array([x, y])
    cos, sin = np.cos(yaw), np.sin(yaw)
    reach = np.abs(offset @ np.array([[cos, -sin], [sin, cos]])).max(-1, initial=0.0)
    inside = [item for row, item in enumerate(map.agent_ids) if reach[row] <= TILE_SIZE / 2 and item != ego]
    return remove_from_map(map, agent_ids=inside)


def _place_of(map: Map, at: At | None) -> dict[str, Any]:
    """Arguments of ``crop_map``."""
    if isinstance(at, str):
        return {"agent": at}
    if at is None:
        raise ValueError("at is missing: give (x, y) or (x, y, yaw) in the frame of the map, or the id of an agent")
    try:
        numbers = [finite_number(value, "at: each number") for value in at]
    except TypeError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise ValueError(f"at must be (x, y), (x, y, yaw) or the id of an agent, not {str(at)[:80]!r}")
    return dict(zip(("x", "y", "yaw"), numbers, strict=False))


def _scenes(value: Any) -> list[Scene]:
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        raise ValueError(
            f"map_or_scene must be a scjax.Scene, a list of them, or a scjax.Map, not {type(value).__name__}: "
            "scjax.import_map reads map files"
        )
    return list(value)


def _check_condition(condition: Condition) -> None:
    for name in ("known", "num_lanes"):
        if getattr(condition, name) is not None:
            raise ValueError(f"condition.{name} follows from the scene or map: leave it out")
    if condition.image is not None:
        raise ValueError("condition.image is given, but placement takes prompts and attributes: leave it out")
    if condition.crop != Crop.CENTERED:
        raise ValueError("condition.crop follows from the scene or map: leave it out")


def _in_scene(placed: Scene, known: Scene | None) -> Scene:
    """The placed scene with the window and domain of the one that was given."""
    assert known is not None
    return placed.replace(crop=known.crop, domain=known.domain)
