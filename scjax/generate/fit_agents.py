"""Agents of a generated scene, moved one after the other until relations that a request names hold.

A network places agents roughly: a car that shall follow stands beside the lane, a queue has a gap of 12 m. The scene
is measured after every move; a move stays if less is missing, and no box or lane gets worse.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from scjax.generate.agent_moves import MOVABLE, draw_move
from scjax.language.analysis.scene_analysis import Analysis, analyze
from scjax.language.attributes.base import Attribute
from scjax.language.attributes.table import ATTRIBUTES
from scjax.scene import AgentType, Scene
from scjax.scene.boxes import overlaps

_MOST_MOVES = 400  # that are tried for one scene
_METERS = 5.0  # of a gap count as one vehicle
_CAP = 5.0  # of what one attribute may lack
_FAULT = 10.0  # of one overlap or vehicle off its lane, beside one agent that is missing
_OFF_LANE, _AGAINST = 1.5, np.deg2rad(90.0)


def fit_agents(scene: Scene, request: Mapping[str, Any], *, known: int = 0) -> Scene:
    """The scene with agents moved so that it shows more of a request; as it is where nothing is missing.

    The ego stays, and so do numbers and classes of agents. The same scene and request give the same result.

    Args:
      scene: one scene.
      request: in its normal form.
      known: so many leading agents stay.
    """
    named = {name: value for name, value in request.items() if name in MOVABLE}
    analysis = analyze(scene)
    if not named or not len(analysis.lines) or len(analysis.agents) <= max(known, 1):
        return scene
    lacking = dict(_lacking(analysis, named))
    if not lacking:
        return scene
    rng, best = np.random.default_rng(0), analysis
    against_allowed = "wrong-way" in named.get("event", ())
    faults = _faults(analysis, against_allowed)
    cost = sum(lacking.values()) + _FAULT * faults
    for _ in range(_MOST_MOVES):
        agents = draw_move(best, rng, {name: named[name] for name in lacking}, max(known, 1))
        if agents is None:
            continue
        moved = best.moved(agents)
        now = dict(_lacking(moved, named))
        if sum(now.values()) >= cost:
            continue
        total = sum(now.values()) + _FAULT * _faults(moved, against_allowed)
        if total < cost:
            best, cost, lacking = moved, total, now
        if not lacking:
            break
    agents = np.array(scene.agents)
    agents[np.asarray(scene.agent_mask)] = best.agents
    return scene.replace(agents=agents)


def _lacking(analysis: Analysis, request: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Name and shortfall of every attribute that does not hold."""
    for name, value in request.items():
        attribute = ATTRIBUTES[name]
        measured = attribute.measure(analysis)
        if not attribute.holds(value, measured):
            yield name, _shortfall(attribute, value, measured)


def _shortfall(attribute: Attribute, request: Any, measured: Any) -> float:
    """How far a measurement is from a request: agents, or as much."""
    if attribute.kind == "set":
        return float(len(set(request) - set(measured)))
    if attribute.kind != "range" or measured is None:
        return 1.0 if attribute.kind != "range" else _CAP / 2
    least, most = request
    distance = max(least - measured, 0.0 if most is None else measured - most)
    return min(float(distance) / (_METERS if attribute.unit else 1.0), _CAP)


def _faults(analysis: Analysis, against_allowed: bool) -> int:
    """Overlapping boxes, and moving vehicles on no lane or against theirs."""
    near, agents = analysis.relations, analysis.agents
    moving = (analysis.types == AgentType.VEHICLE) & (analysis.speeds > 0.5)
    moving[:1] = False
    off = moving & (near.offset > _OFF_LANE)
    along = (near.distance < 2.0) & (near.angle < _AGAINST)
    against = moving & ~off & ~along.any(1)
    return int(np.triu(overlaps(agents)).sum() + off.sum() + (0 if against_allowed else against.sum()))
