"""Signs that a scene from a file is not what it says: wrong units, wrong frame, an ego that is none."""

from __future__ import annotations

import numpy as np

from scjax.metrics.realism import OPEN_CONNECTION, connection_gaps, lane_offsets, overlapping_pairs
from scjax.scene import AgentType, Scene

_LEAST = 4  # vehicles or connections; fewer say nothing
PLAUSIBLE_LENGTHS = {
    AgentType.VEHICLE: (1.5, 25.0),
    AgentType.PEDESTRIAN: (0.15, 3.0),
    AgentType.CYCLIST: (0.5, 4.0),
}
"""Range of the median length of a class [m]."""


def scene_warnings(scene: Scene) -> list[str]:
    """What looks wrong in one unpadded NumPy scene, one sentence each, with the likely cause."""
    warnings = []
    if len(scene.agents) and scene.agent_types[0] != AgentType.VEHICLE:
        word = AgentType(int(scene.agent_types[0])).name.lower()
        warnings.append(f"agent 0 is a {word}, no vehicle: there is no ego")
    for agent_type, (low, high) in PLAUSIBLE_LENGTHS.items():
        lengths = scene.agents[(scene.agent_types == agent_type) & scene.agent_known[:, 6], 6]
        if len(lengths) and not low <= (middle := float(np.median(lengths))) <= high:
            warnings.append(f"a {agent_type.name.lower()} is {middle:.3g} m long: other units than m?")
    speeds = np.abs(scene.agents[:, 3])
    if (fast := int((speeds > 70.0).sum())) > 0:
        warnings.append(f"{fast} agents are faster than 70 m/s: km/h?")
    vehicles = int((scene.agent_types == AgentType.VEHICLE).sum())
    if len(scene.lanes) and vehicles >= _LEAST:
        distance, angle = lane_offsets(scene)
        if (far := float((distance > 4.0).mean())) > 0.7:
            warnings.append(f"{far:.0%} of vehicles are more than 4 m from every lane: do both have the same frame?")
        elif len(angle) >= _LEAST and (off := float((angle > 45.0).mean())) > 0.7:
            warnings.append(f"{off:.0%} of vehicles do not head along their lane: headings from north, or clockwise?")
    if vehicles >= _LEAST and len(pairs := overlapping_pairs(scene)):
        share = len(np.unique(pairs)) / len(scene.agents)
        if share > 0.5:
            warnings.append(f"{share:.0%} of agents overlap another one: are they listed twice?")
    gaps = connection_gaps(scene)
    if len(gaps) and (wide := int((gaps > 5 * OPEN_CONNECTION).sum())):
        warnings.append(f"{wide} of {len(gaps)} lane connections are open by more than {5 * OPEN_CONNECTION:g} m")
    return warnings
