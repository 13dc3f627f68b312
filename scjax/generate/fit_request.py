"""Generated scenes, changed until they show what is requested, and the best of several."""

from __future__ import annotations

from collections.abc import Sequence

from scjax.generate.best_of import best_order, score_scene
from scjax.generate.fit_agents import fit_agents
from scjax.generate.fit_slope import fit_slope
from scjax.generate.requests import Request
from scjax.scene import Scene


def fit_request(scene: Scene, request: Request) -> Scene:
    """Inclines the ground and moves agents until the scene shows more of the request; known elements stay.

    Scenes with known lanes, or whose agents a picture shows, stay as they are.
    """
    spec = request.spec
    known_agents, known_lanes = spec.known_counts
    if known_lanes or spec.picture is not None or not spec.attributes:
        return scene
    return fit_agents(fit_slope(scene, spec.attributes), spec.attributes, known=known_agents)


def best_fitted(scenes: Sequence[Scene], requests: Sequence[Request]) -> Scene:
    """The scene of least ``score_scene`` after ``fit_request``; the first that shows all is taken.

    Raises:
      ValueError: there are no scenes.
    """
    if len(scenes) == 1:
        return fit_request(scenes[0], requests[0])
    fitted, scores, attributes = [], [], requests[0].spec.attributes
    for place in best_order(scenes, attributes):
        fitted.append(fit_request(scenes[place], requests[place]))
        scores.append(score_scene(fitted[-1], attributes))
        if scores[-1].missed == 0:
            return fitted[-1]
    return fitted[scores.index(min(scores))]
