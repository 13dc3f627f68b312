"""Outlines of agents from above, in meters, with the front towards +x."""

from __future__ import annotations

import dataclasses

import numpy as np
from matplotlib.path import Path as Outline

from scjax.scene import AgentType
from scjax.scene.agent_sizes import CLASS_SIZES

_MOVE, _LINE, _CURVE, _CLOSE = Outline.MOVETO, Outline.LINETO, Outline.CURVE3, Outline.CLOSEPOLY
GLASS, GLASS_OPACITY = "#20252d", 0.55
_OTHER_SIZE = (1.0, 1.0)  # m


@dataclasses.dataclass(frozen=True)
class AgentShape:
    """How an agent looks.

    Attributes:
      body: outline in the color of the agent.
      glass: parts on it in ``GLASS``, which show where the front is.
      rider: a part on it in a darker color: the head of a cyclist, the nose of a pedestrian; None for most.
    """

    body: Outline
    glass: tuple[Outline, ...] = ()
    rider: Outline | None = None


def agent_shape(agent_type: int, size: np.ndarray, smallest: float) -> AgentShape:
    """The shape of an agent.

    Args:
      agent_type: ``AgentType`` or ``OTHER_OBJECT``.
      size: length and width [m], NaN where not known.
      smallest: width below which nothing can be seen in the picture [m]; people are drawn that large at least.
    """
    known = AgentType(agent_type) if agent_type >= 0 else None
    length, width = np.where(np.isfinite(size[:2]), size[:2], _OTHER_SIZE if known is None else CLASS_SIZES[known][:2])
    length, width = max(float(length), 0.2), max(float(width), 0.2)
    if known == AgentType.VEHICLE:
        return _vehicle(length, width)
    if known == AgentType.PEDESTRIAN:
        radius = max(min(length, width) / 2, 0.35, smallest / 2)
        nose = np.array([[0.6 * radius, 0.8 * radius], [1.7 * radius, 0.0], [0.6 * radius, -0.8 * radius]])
        return AgentShape(_circle(radius), rider=_polygon(nose))
    if known == AgentType.CYCLIST:
        width = max(width, smallest)
        head = _circle(0.36 * width, 0.12 * length)
        return AgentShape(rounded_box(length, 0.8 * width, 0.4 * width, 0.3 * width), rider=head)
    return AgentShape(rounded_box(max(length, smallest), max(width, smallest), 0.1 * width, 0.1 * width))


def _vehicle(length: float, width: float) -> AgentShape:
    """A box with round corners, with a windscreen, and a rear window if it is no lorry."""
    body = rounded_box(length, width, 0.4 * width, 0.22 * width)
    front = length / 2
    hood = 0.27 * length if length < 6.5 else 0.35  # m from the front to the windscreen
    pane = min(0.13 * length, 0.8)
    outer, inner = 0.43 * width, 0.36 * width
    screen = np.array([[front - hood, -outer], [front - hood, outer], [front - hood - pane, inner]])
    screen = _polygon(np.vstack([screen, [front - hood - pane, -inner]]))
    if length >= 6.5:
        return AgentShape(body, (screen,))
    rear = -front + 0.1 * length
    back = np.array([[rear, -0.36 * width], [rear, 0.36 * width], [rear + 0.6 * pane, 0.34 * width]])
    return AgentShape(body, (screen, _polygon(np.vstack([back, [rear + 0.6 * pane, -0.34 * width]]))))


def rounded_box(length: float, width: float, front_radius: float, rear_radius: float) -> Outline:
    """A box around the origin with round corners."""
    x, y = length / 2, width / 2
    front, rear = (min(radius, x, y) for radius in (front_radius, rear_radius))
    points = [(x, y - front), (x, y), (x - front, y), (-x + rear, y), (-x, y), (-x, y - rear)]
    points += [(-x, -y + rear), (-x, -y), (-x + rear, -y), (x - front, -y), (x, -y), (x, -y + front), (x, y - front)]
    codes = [_MOVE, _CURVE, _CURVE, _LINE, _CURVE, _CURVE, _LINE, _CURVE, _CURVE, _LINE, _CURVE, _CURVE, _CLOSE]
    return Outline(points, codes)


def _circle(radius: float, x: float = 0.0) -> Outline:
    circle = Outline.unit_circle()
    return Outline(np.asarray(circle.vertices) * radius + np.array([x, 0.0]), circle.codes)


def _polygon(points: np.ndarray) -> Outline:
    return Outline(np.vstack([points, points[:1]]), [_MOVE] + [_LINE] * (len(points) - 1) + [_CLOSE])
