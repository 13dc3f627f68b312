"""Conditions from a reference scene: its counts, lanes or caption."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from scjax.evaluate.sources import SceneSource
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.language.attributes.draw import full_request
from scjax.language.attributes.request_text import request_text
from scjax.language.attributes.table import measure_attributes
from scjax.scene import Scene, empty

RequestFunction = Callable[[Scene, int], Condition]
"""(reference, its row) -> the condition that the model gets."""

_AGENT_FIELDS = ("agents", "agent_types", "agent_mask", "agent_known")


def caption_of(scene: Scene) -> str:
    """The text of a request for all that the scene shows; models and retrieval baselines get the same one."""
    return request_text(full_request(measure_attributes(scene)))


def counts_request(model: Model, scene: Scene, domain: str | None) -> Condition:
    """Asks for the numbers of lanes and agents of a scene, and for its domain if the model knows it."""
    return Condition(
        num_lanes=max(len(scene.lane_mask), 1),
        num_agents=max(len(scene.agent_mask), 1),
        domain=domain if domain in model.domains else None,
    )


def unconditional_request(model: Model, scene: Scene, domain: str | None) -> Condition:
    """Asks for nothing: counts and domain are drawn from the training distribution."""
    return Condition()


def lanes_request(model: Model, scene: Scene, domain: str | None) -> Condition:
    """Asks for traffic on the lanes of a scene, with its number of agents."""
    none = empty(0, 0)
    known = model.codec.select(scene).replace(**{name: getattr(none, name) for name in _AGENT_FIELDS})
    return dataclasses.replace(counts_request(model, scene, domain), num_lanes=len(known.lane_mask) or 1, known=known)


def prompt_request(model: Model, scene: Scene, domain: str | None) -> Condition:
    """Asks by the caption of a scene; the model chooses the counts."""
    return Condition(prompt=caption_of(scene), domain=domain if domain in model.domains else None)


_REQUEST_FUNCTIONS = {
    "counts": counts_request,
    "lanes": lanes_request,
    "prompt": prompt_request,
    "shuffled_prompt": prompt_request,
    "none": unconditional_request,
}


def request_function(model: Model, reference: SceneSource, request: str) -> RequestFunction:
    """The function behind ``MethodSpec.request``.

    Raises (when called):
      ValueError: a shuffled prompt, but all references lie at one location.
    """
    base, _, counts = request.partition("+")
    make_condition = _REQUEST_FUNCTIONS[base]
    domains = getattr(reference, "domains", ())

    def condition_for(scene: Scene, row: int) -> Condition:
        index = int(scene.domain)
        domain = domains[index] if index < len(domains) else None
        subject = scene
        if base == "shuffled_prompt":
            (subject,) = reference.read([_row_elsewhere(reference.clusters, row)])
        condition = make_condition(model, subject, domain)
        if not counts:
            return condition
        own = counts_request(model, scene, domain)
        return dataclasses.replace(condition, num_lanes=own.num_lanes, num_agents=own.num_agents)

    return condition_for


def _row_elsewhere(clusters: list[str], row: int) -> int:
    """The next row, cyclically, at another location."""
    others = (*range(row + 1, len(clusters)), *range(row))
    elsewhere = next((other for other in others if clusters[other] != clusters[row]), None)
    if elsewhere is None:
        raise ValueError(f"all references lie at {clusters[row]}: there is no prompt of another location")
    return elsewhere
