"""A rendered dashcam of scenes, maps and logs: pictures with exact depth, classes and ids, of a seeded look."""

from scjax.camera.dashcam.look import WEATHER, Look, random_look
from scjax.camera.dashcam.materials import SemanticClass
from scjax.camera.dashcam.renderer import DashcamFrame, DashcamRenderer, render_dashcam

__all__ = [
    "WEATHER",
    "DashcamFrame",
    "DashcamRenderer",
    "Look",
    "SemanticClass",
    "random_look",
    "render_dashcam",
]
