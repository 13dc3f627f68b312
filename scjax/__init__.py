"""scjax: text- and image-controlled generation of vectorized driving scenes, in JAX.

model = scjax.load("runs/denoiser/model")
scenes = scjax.sample(jax.random.key(0), scjax.Condition(num_agents=12), model=model, n=4)
scjax.viz.grid(scenes, path="scenes.png")
"""

from scjax.diffusion.guidance import Guidance
from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.model import load_model as load
from scjax.generate.model import save_model as save
from scjax.generate.sample import reconstruct, sample, sample_many
from scjax.scene import AgentType, Crop, Link, Scene, Signal, validate
from scjax.scene.repair import repair

__version__ = "0.1.0"
__all__ = [
    "AgentType",
    "Condition",
    "Crop",
    "Guidance",
    "Link",
    "Model",
    "Scene",
    "Signal",
    "load",
    "reconstruct",
    "repair",
    "sample",
    "sample_many",
    "save",
    "validate",
]  # fmt: skip
