"""A window of the training that looks like a picture, and the agents that the picture shows, at speeds as there."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.generate.components import Model
from scjax.generate.scene_spec import KnownElements, SceneSpec
from scjax.generate.seen_agents import SeenAgents, held_scene
from scjax.models.denoiser.kinds import digits_of
from scjax.scene import AgentType, Scene
from scjax.scene.scene import LARGE_LENGTH

_SPEEDS = (0.0, 2.0, 8.0, 14.0)  # m/s, of the classes of speeds


def draw_view(rng: np.random.Generator, spec: SceneSpec, model: Model) -> int | None:
    """Number of an outline of a window that looks like the picture (``Model.views``).

    Returns:
      None without a picture, with elements of the user, or if the model does not choose outlines by pictures.
    """
    image = spec.streams.get("image")
    if image is None or model.views is None or spec.known is not None or not model.denoiser.config.agent_kinds:
        return None
    cells = np.asarray(image.grid())
    tokens = cells.reshape(len(cells), -1).T
    seen = None if spec.picture is None else spec.picture.lanes
    return model.views.draw(
        rng, tokens, cells.shape[1:], num_lanes=spec.num_lanes, num_agents=spec.num_agents, seen=seen
    )


def hold_seen_agents(spec: SceneSpec, view: int, model: Model) -> SceneSpec:
    """With the agents that the picture shows as known elements; as it is where these do not hold.

    Args:
      view: number of a window that looks like the picture.
    """
    if spec.picture is None:
        return spec
    known = _held_agents(spec.picture.agents, view, spec.num_agents, spec.domain, model)
    return dataclasses.replace(spec, known=KnownElements(model.codec.select(known)))


def _held_agents(seen: SeenAgents, view: int, num_agents: int | None, domain: int | None, model: Model) -> Scene:
    """The ego and the agents that a picture shows, as known elements.

    A picture shows no speeds: agents have those of agents of their class and direction in the window of the view.

    Args:
      num_agents: of all agents, the ego included; None: as many as are seen.
      domain: of the scene; None: that of the window.
    """
    views, codec = model.views, model.codec
    assert views is not None
    most = min(num_agents or model.denoiser.config.max_agents, model.denoiser.config.max_agents) - 1
    known_types = np.isin(seen.types, [int(kind) for kind in codec.agent_types])
    seen = SeenAgents(*(values[known_types][:most] for values in seen))
    others = views.agents[view][views.agents[view] >= 0].astype(np.int64)
    classes, speeds, sectors = (np.asarray(digit) for digit in digits_of(others, views.agent_sizes)[:3])
    left = np.ones(len(others), bool)
    left[0] = False
    own = [_SPEEDS[int(speeds[0])]]
    for kind, heading, length in zip(seen.types.tolist(), seen.headings, seen.sizes[:, 0], strict=True):
        is_large = kind == AgentType.VEHICLE and length > LARGE_LENGTH
        class_ = len(codec.agent_types) if is_large else codec.agent_types.index(AgentType(kind))
        alike = np.flatnonzero(left & (classes == class_) & (sectors == round(float(heading) / (np.pi / 4)) % 8))
        own.append(_SPEEDS[int(speeds[alike[0]])] if len(alike) else 0.0)
        left[alike[:1]] = False
    return held_scene(seen, np.array(own), int(views.domains[view]) if domain is None else domain)
