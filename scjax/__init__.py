"""scjax: text- and image-controlled generation of vectorized driving scenes, in JAX.

model = scjax.load("runs/denoiser/model")
scenes = scjax.sample(jax.random.key(0), scjax.Condition(num_agents=12), model=model, n=4)
scjax.viz.grid(scenes, path="scenes.png")
"""

from scjax.condition import Condition
from scjax.diffusion.guidance import Guidance
from scjax.model import Model, load, save
from scjax.sampling import reconstruct, sample, sample_many
from scjax.scene import AgentType, Layout, Link, Scene, Signal, validate
from scjax.tidy import tidy

__version__ = "0.1.0"
__all__ = [
    "AgentType", "Condition", "Guidance", "Layout", "Link", "Model", "Scene", "Signal", "load", "reconstruct", "sample",
    "sample_many", "save", "tidy", "validate",
]  # fmt: skip
