"""Denoisers that are exact for Gaussian data or one data point, and samplers with a prediction that they suit."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from scjax.diffusion.flow import flow_level, flow_schedule
from scjax.diffusion.samplers import DDIM, DDPM, DPMSolver, Euler, Heun, Threshold, make_schedule
from scjax.diffusion.samplers.loop import sample_latents
from scjax.diffusion.schedule import cosine_schedule, respace
from scjax.scene.per_type import PerType
from tests.factories import golden

LATENT_WIDTHS, MAX_TOKENS = PerType(agents=3, lanes=5), PerType(agents=7, lanes=9)
UNIT_TEMPERATURE = PerType(agents=1.0, lanes=1.0)
SAMPLER_CASES = {
    "ddpm": (DDPM(), "velocity"),
    "ddim": (DDIM(), "noise"),
    "ddim, eta 0.7": (DDIM(eta=0.7), "velocity"),
    "dpm++": (DPMSolver(), "noise"),
    "dpm++, dynamic": (DPMSolver(Threshold(2.0, quantile=0.9)), "velocity"),
    "dpm++, flow": (DPMSolver(), "flow"),
    "euler": (Euler(), "flow"),
    "heun": (Heun(), "flow"),
}


def training_levels(prediction, total=100):
    """All noise levels of training [total], indexed by the timestep."""
    if prediction == "flow":
        return flow_level(jnp.arange(1, total + 1) / total, total)
    return cosine_schedule(total).levels


def denoiser_from_x0(x0_fn, prediction, total=100):
    """denoise(z, t) whose x0 estimate is x0_fn(alpha, sigma, latents of one type, "agents" or "lanes")."""
    levels = training_levels(prediction, total)

    def denoise(z, t):
        level = levels[t.astype(jnp.int32)]
        alpha, sigma = level.alpha[:, None, None], level.sigma[:, None, None]

        def output(x, name):
            x0 = x0_fn(alpha, sigma, x, name)
            eps = (x - alpha * x0) / sigma
            return {"noise": eps, "velocity": alpha * eps - sigma * x0, "flow": eps - x0}[prediction]

        return jax.tree.map(output, z, PerType(agents="agents", lanes="lanes"))

    return denoise


def gaussian_denoiser(mean, std, prediction, total=100):
    """The exact denoiser of x0 ~ N(mean, std^2)."""

    def x0_fn(alpha, sigma, x, _):
        return mean + alpha * std**2 / (alpha**2 * std**2 + sigma**2) * (x - alpha * mean)

    return denoiser_from_x0(x0_fn, prediction, total)


def point_denoiser(clean, prediction):
    """The exact denoiser of a data set that holds only ``clean``."""
    return denoiser_from_x0(lambda alpha, sigma, x, name: getattr(clean, name), prediction)


def schedule_for(sampler, prediction, steps, total=100):
    """``make_schedule`` for any number of training timesteps."""
    if total == 100:
        return make_schedule(sampler, prediction, steps)
    if prediction == "flow":
        return flow_schedule(steps, total, sampler.last_step)
    return respace(cosine_schedule(total), steps, sampler.last_step)


def token_masks(sizes, agents=7, lanes=9):
    """True at valid tokens [B, tokens] per type, from (agents, lanes) per scene."""
    sizes = jnp.asarray(sizes)
    return PerType(agents=jnp.arange(agents)[None] < sizes[:, :1], lanes=jnp.arange(lanes)[None] < sizes[:, 1:])


def sample_case(case, denoise, keys, masks, steps, total=100, known=None, known_latents=None, **options):
    """Samples of a case of ``SAMPLER_CASES``, or of a pair (sampler, prediction); compiled."""
    sampler, prediction = SAMPLER_CASES[case] if isinstance(case, str) else case
    schedule = schedule_for(sampler, prediction, steps, total)

    @golden.jit
    def run(keys, masks, known, known_latents):
        return sample_latents(
            denoise,
            schedule,
            keys,
            masks,
            sampler=sampler,
            prediction=prediction,
            latent_widths=LATENT_WIDTHS,
            max_tokens=MAX_TOKENS,
            known=known,
            known_latents=known_latents,
            **options,
        )

    return run(keys, masks, known, known_latents)
