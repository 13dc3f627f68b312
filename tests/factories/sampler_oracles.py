"""Networks whose estimate is exact, for data that is normal, or a single point; and every sampler with what it fits."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from scjax.diffusion.flow import flow_level
from scjax.diffusion.samplers import DDIM, DDPM, DPMSolver, Euler, Heun, Threshold, schedule_of
from scjax.diffusion.samplers.loop import sample
from scjax.diffusion.schedule import cosine_schedule, respaced
from scjax.scene.per_type import PerType
from tests.factories import golden

WIDTHS, MOST = PerType(agents=3, lanes=5), PerType(agents=7, lanes=9)
EVEN = PerType(agents=1.0, lanes=1.0)
CASES = {
    "ddpm": (DDPM(), "velocity"),
    "ddim": (DDIM(), "noise"),
    "ddim, eta 0.7": (DDIM(eta=0.7), "velocity"),
    "dpm++": (DPMSolver(), "noise"),
    "dpm++, dynamic": (DPMSolver(Threshold(2.0, quantile=0.9)), "velocity"),
    "dpm++, flow": (DPMSolver(), "flow"),
    "euler": (Euler(), "flow"),
    "heun": (Heun(), "flow"),
}


def levels_of(prediction, total=100):
    """All levels of training; index: the time."""
    if prediction == "flow":
        return flow_level(jnp.arange(1, total + 1) / total, total)
    return cosine_schedule(total).levels


def network(x0_of, prediction, total=100):
    """denoise(z, t) of a function (level, one kind of latents, its name) -> x_0."""
    levels = levels_of(prediction, total)

    def denoise(z, t):
        level = levels[t.astype(jnp.int32)]
        signal, noise = level.signal[:, None, None], level.noise[:, None, None]

        def output(x, name):
            x0 = x0_of(signal, noise, x, name)
            eps = (x - signal * x0) / noise
            return {"noise": eps, "velocity": signal * eps - noise * x0, "flow": eps - x0}[prediction]

        return jax.tree.map(output, z, PerType(agents="agents", lanes="lanes"))

    return denoise


def normal(mean, std, prediction, total=100):
    """The exact network of x_0 ~ N(mean, std^2)."""

    def x0_of(signal, noise, x, _):
        return mean + signal * std**2 / (signal**2 * std**2 + noise**2) * (x - signal * mean)

    return network(x0_of, prediction, total)


def knowing(clean, prediction):
    """The network that knows x_0."""
    return network(lambda signal, noise, x, name: getattr(clean, name), prediction)


def schedule(sampler, prediction, steps, total=100):
    """As ``schedule_of``, out of any number of timesteps."""
    if total == 100:
        return schedule_of(sampler, prediction, steps)
    if prediction == "flow":
        from scjax.diffusion.flow import flow_schedule

        return flow_schedule(steps, total, sampler.last)
    return respaced(cosine_schedule(total), steps, sampler.last)


def masks(sizes, agents=7, lanes=9):
    """True at valid tokens, from (agents, lanes) a scene."""
    sizes = jnp.asarray(sizes)
    return PerType(agents=jnp.arange(agents)[None] < sizes[:, :1], lanes=jnp.arange(lanes)[None] < sizes[:, 1:])


def drawn(case, denoise, keys, mask, steps, total=100, **options):
    """Samples of one of ``CASES``, compiled."""
    sampler, prediction = CASES[case] if isinstance(case, str) else case
    levels = schedule(sampler, prediction, steps, total)

    @golden.jit
    def run(keys, mask, known, values):
        return sample(
            denoise, levels, keys, mask, sampler=sampler, prediction=prediction, widths=WIDTHS, most=MOST,
            known=known, values=values, **options,
        )  # fmt: skip

    known = options.pop("known", None), options.pop("values", None)
    return run(keys, mask, *known)
