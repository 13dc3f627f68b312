"""Colors of wireframes (RGB), by name."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Int, UInt8

from scjax.scene import OTHER_OBJECT, AgentType, Signal
from scjax.scene.scene import LARGE_LENGTH

Color = tuple[int, int, int]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Palette:
    """Colors of what a wireframe shows.

    Attributes:
      agents: of each ``AgentType``.
      large_vehicle: of vehicles longer than ``LARGE_LENGTH``.
      other: of objects of no ``AgentType``.
      lane, border, stop_line: of lines on the road.
      signals: of stop lines and heads of signals in each state.
      recolors_lanes: whether a lane has the color of its signal.
    """

    agents: dict[AgentType, Color]
    large_vehicle: Color
    other: Color
    lane: Color
    border: Color
    stop_line: Color
    signals: dict[Signal, Color]
    recolors_lanes: bool

    def agent_colors(self, types: Int[np.ndarray, " n"], lengths: np.ndarray) -> UInt8[np.ndarray, "n 3"]:
        """Colors of agents of these types and lengths [m]."""
        table = np.array([self.agents[kind] for kind in AgentType] + [self.other], np.uint8)
        colors = table[types]  # OTHER_OBJECT is -1, the last row
        colors[(types == AgentType.VEHICLE) & (lengths > LARGE_LENGTH)] = self.large_vehicle
        return colors

    def signal_colors(self, states: Int[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
        """Colors of signals in these states."""
        return np.array([self.signals[state] for state in Signal], np.uint8)[states]


assert OTHER_OBJECT == -1
_BLUE, _GREEN, _YELLOW, _WHITE = (98, 183, 249), (0, 255, 0), (255, 255, 0), (255, 255, 255)
_LANE, _WAIT = (56, 103, 221), (185, 63, 34)
_STATES = {Signal.UNKNOWN: _WAIT, Signal.GO: (0, 200, 0), Signal.CAUTION: (255, 170, 0), Signal.STOP: (255, 0, 0)}

PALETTES: dict[str, Palette] = {
    "scjax": Palette(
        agents={
            AgentType.VEHICLE: _BLUE,
            AgentType.PEDESTRIAN: _GREEN,
            AgentType.CYCLIST: _YELLOW,
            AgentType.STATIC: _WHITE,
        },
        large_vehicle=_BLUE,
        other=_WHITE,
        lane=_LANE,
        border=(126, 204, 205),
        stop_line=_WAIT,
        signals=_STATES,
        recolors_lanes=True,
    ),
    "cosmos": Palette(
        agents={
            AgentType.VEHICLE: (255, 0, 0),
            AgentType.PEDESTRIAN: _GREEN,
            AgentType.CYCLIST: _YELLOW,
            AgentType.STATIC: _WHITE,
        },
        large_vehicle=(0, 0, 255),
        other=_WHITE,
        lane=_LANE,
        border=(200, 36, 35),
        stop_line=_WAIT,
        signals=dict.fromkeys(Signal, (252, 157, 155)),
        recolors_lanes=False,
    ),
    "sc": Palette(
        agents={
            AgentType.VEHICLE: _BLUE,
            AgentType.PEDESTRIAN: _GREEN,
            AgentType.CYCLIST: _YELLOW,
            AgentType.STATIC: _YELLOW,
        },
        large_vehicle=_BLUE,
        other=_YELLOW,
        lane=_WHITE,
        border=(0, 255, 255),
        stop_line=_WAIT,
        signals=_STATES,
        recolors_lanes=True,
    ),
}
"""scjax: the default. cosmos: the control videos of Cosmos-Drive-Dreams, whose signals show no state. sc: the pictures
of ScenarioControl, whose third class is static in nuPlan."""


def palette_of(name: str) -> Palette:
    """The palette of that name; ValueError lists those there are."""
    if name not in PALETTES:
        raise ValueError(f"there is no palette {name!r}: choose from {', '.join(PALETTES)}")
    return PALETTES[name]
