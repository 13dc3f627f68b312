"""scjax: text- and image-controlled generation of vectorized driving scenes, in JAX.

    import jax
    import scjax

    condition = scjax.Condition(prompt="a T-intersection with several vehicles", num_agents=12)
    scenes = scjax.sample(jax.random.key(0), condition, num_scenes=4)
    scjax.viz.grid(scenes, path="scenes.png")

Scenes:     Scene, AgentType, Signal, Link, Crop, validate, repair
Logs:       Log, load_log, save_log, crop_log, validate_log
Maps:       Map, import_map, import_log, load_map, save_map, crop_map, validate_map
Requests:   Condition, Stream, Guidance, EnergyGuidance, PerType, samplers
Models:     Model, load, save
Generation: sample, place, reconstruct, regenerate_agents, regenerate_region
Exports:    export_log
Maps grow:  outpaint, extend_map, complete_rear
Traffic:    simulate, drive, RouteFollower, ConstantVelocity, Action, Observation
Editing:    insert_agent, move_agent, remove_agents
Pictures:   viz, camera

Each name is imported when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scjax import camera, viz
    from scjax.data.imports import import_log, import_map
    from scjax.data.log_crop import crop_log
    from scjax.data.map_crop import crop_map
    from scjax.diffusion import samplers
    from scjax.diffusion.energy_guidance import EnergyGuidance
    from scjax.diffusion.guidance import Guidance
    from scjax.export import export_log
    from scjax.generate.conditions import Condition, Stream
    from scjax.generate.edit import regenerate_agents, regenerate_region
    from scjax.generate.model import Model
    from scjax.generate.model import load_model as load
    from scjax.generate.model import save_model as save
    from scjax.generate.place import place_traffic as place
    from scjax.generate.reconstruct import reconstruct
    from scjax.generate.sample import sample_scenes as sample
    from scjax.outpainting.extend import extend_map
    from scjax.outpainting.outpaint import outpaint
    from scjax.outpainting.rear import complete_rear
    from scjax.scene import (
        AgentType,
        Crop,
        Link,
        Log,
        Map,
        Scene,
        Signal,
        load_log,
        load_map,
        save_log,
        save_map,
        validate,
        validate_log,
        validate_map,
    )
    from scjax.scene.edit import insert_agent, move_agent, remove_agents
    from scjax.scene.per_type import PerType
    from scjax.scene.repair import repair
    from scjax.sim.bicycle import Action
    from scjax.sim.constant_velocity import ConstantVelocity
    from scjax.sim.drive import drive
    from scjax.sim.observation import Observation
    from scjax.sim.route_follower import RouteFollower
    from scjax.sim.simulate import simulate

__version__ = "0.1.0"
__all__ = [
    "Action",
    "AgentType",
    "Condition",
    "ConstantVelocity",
    "Crop",
    "EnergyGuidance",
    "Guidance",
    "Link",
    "Log",
    "Map",
    "Model",
    "Observation",
    "PerType",
    "RouteFollower",
    "Scene",
    "Signal",
    "Stream",
    "camera",
    "complete_rear",
    "crop_log",
    "crop_map",
    "drive",
    "export_log",
    "extend_map",
    "import_log",
    "import_map",
    "insert_agent",
    "load",
    "load_log",
    "load_map",
    "move_agent",
    "outpaint",
    "place",
    "reconstruct",
    "regenerate_agents",
    "regenerate_region",
    "remove_agents",
    "repair",
    "sample",
    "samplers",
    "save",
    "save_log",
    "save_map",
    "simulate",
    "validate",
    "validate_log",
    "validate_map",
    "viz",
]


_PLACES = {
    "scjax.data.imports": ("import_log", "import_map"),
    "scjax.data.log_crop": ("crop_log",),
    "scjax.data.map_crop": ("crop_map",),
    "scjax.diffusion.energy_guidance": ("EnergyGuidance",),
    "scjax.diffusion.guidance": ("Guidance",),
    "scjax.export": ("export_log",),
    "scjax.generate.conditions": ("Condition", "Stream"),
    "scjax.generate.edit": ("regenerate_agents", "regenerate_region"),
    "scjax.generate.model": ("Model", "load=load_model", "save=save_model"),
    "scjax.generate.place": ("place=place_traffic",),
    "scjax.generate.reconstruct": ("reconstruct",),
    "scjax.generate.sample": ("sample=sample_scenes",),
    "scjax.outpainting.extend": ("extend_map",),
    "scjax.outpainting.outpaint": ("outpaint",),
    "scjax.outpainting.rear": ("complete_rear",),
    "scjax.scene": (
        "AgentType",
        "Crop",
        "Link",
        "Log",
        "Map",
        "Scene",
        "Signal",
        "load_log",
        "load_map",
        "save_log",
        "save_map",
        "validate",
        "validate_log",
        "validate_map",
    ),
    "scjax.scene.edit": ("insert_agent", "move_agent", "remove_agents"),
    "scjax.scene.per_type": ("PerType",),
    "scjax.scene.repair": ("repair",),
    "scjax.sim.bicycle": ("Action",),
    "scjax.sim.constant_velocity": ("ConstantVelocity",),
    "scjax.sim.drive": ("drive",),
    "scjax.sim.observation": ("Observation",),
    "scjax.sim.route_follower": ("RouteFollower",),
    "scjax.sim.simulate": ("simulate",),
}
"""Module -> the public names in it, and what they are called there. Each is imported when it is first used: the command
line prints its help without JAX."""

_MODULES = {"camera": "scjax.camera", "samplers": "scjax.diffusion.samplers", "viz": "scjax.viz"}


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used."""
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    for module, places in _PLACES.items():
        for public, _, inner in (place.partition("=") for place in places):
            if public == name:
                value = globals()[name] = getattr(importlib.import_module(module), inner or public)
                return value
    raise AttributeError(f"module 'scjax' has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names, also those that are not imported yet."""
    return sorted({*globals(), *__all__})
