"""Energies of scenes: plain functions ``Scene`` [B] -> energy [B], one per file.

An energy is differentiable almost everywhere and falls as the scene improves. In m^2, its gradient is a displacement in
meters. To add one, write a file and enter it in ``ENERGIES``; ``EnergyGuidance(energies=...)`` then accepts its name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jaxtyping import Array, Float

from scjax.diffusion.energies.collision import collision_energy
from scjax.diffusion.energies.connections import connection_energy
from scjax.diffusion.energies.off_lane import off_lane_energy
from scjax.diffusion.energies.overlap import overlap_energy
from scjax.scene import Scene

SceneEnergy = Callable[[Scene], Float[Array, " b"]]

ENERGIES: dict[str, SceneEnergy] = {
    "connections": connection_energy,
    "overlap": overlap_energy,
    "off_lane": off_lane_energy,
    "collision": collision_energy,
}


def weighted_energy(scene: Scene, energies: Sequence[tuple[str, float]]) -> Float[Array, " b"]:
    """Weighted sum of the ``energies`` (name, weight) of a batch of scenes, added in their order."""
    first, *others = (weight * ENERGIES[name](scene) for name, weight in energies)
    return sum(others, start=first)
