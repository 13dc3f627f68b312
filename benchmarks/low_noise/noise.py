"""How far noise in the latents moves the ends of lanes, and how far one evaluation of the denoiser brings them back."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from scjax.diffusion.log_snr_schedule import cosine_time
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.process import estimate_x0, q_sample
from scjax.generate.batching import in_batches
from scjax.generate.compiled import decode_program, encode_program
from scjax.generate.model import Model
from scjax.models.autoencoder.model import autoencoder
from scjax.models.denoiser.model import denoiser
from scjax.scene import Link, Scene, stack
from scjax.scene.per_type import PerType

SIGMAS = (0.0, 0.005, 0.01, 0.025, 0.05, 0.074, 0.1, 0.2)
_GROUP, _LEAST_SIZE = 8, (32, 32)  # few shapes, so that few programs are compiled


@dataclasses.dataclass(frozen=True)
class NoiseRow:
    """Lane ends of scenes that noisy or denoised latents decode to.

    Attributes:
      sigma: deviation of the noise, in deviations of the latents.
      shift: root mean square distance [m] of lane ends and starts from where the clean latents put them.
      gap: mean gap [m] of the ends that the recorded links join; open_links: share above 0.5 m [percent].
    """

    sigma: float
    shift: float
    gap: float
    open_links: float


def posterior_deviations(model: Model, scenes: Sequence[Scene]) -> dict[str, list[float]]:
    """Quantiles 0.1, 0.5, 0.9 of the posterior's deviation, in deviations of the latents, per type."""
    network = autoencoder(model.autoencoder.config)
    values: dict[str, list[np.ndarray]] = {"agents": [], "lanes": []}
    encode = jax.jit(lambda params, scene: network.apply(params, model.codec.normalize(scene), method="encode"))
    for padded, _ in padded_batches(scenes):
        posterior = encode(model.autoencoder.params, padded)
        for name, mask in (("agents", padded.agent_mask), ("lanes", padded.lane_mask)):
            std = np.exp(0.5 * np.asarray(getattr(posterior.logvar, name)))[np.asarray(mask)]
            values[name].append(std.ravel() / getattr(model.latents.std, name))
    return {name: np.quantile(np.concatenate(parts), (0.1, 0.5, 0.9)).tolist() for name, parts in values.items()}


def noise_rows(model: Model, scenes: Sequence[Scene], denoised: bool, seed: int = 0) -> list[NoiseRow]:
    """A row per deviation; ``denoised``: of the denoiser's estimates instead of the noisy latents themselves."""
    coder = model.codec, model.autoencoder.config
    params, statistics = model.autoencoder.params, (model.latents.mean, model.latents.std)
    config = model.denoiser.config if denoised else None

    @jax.jit
    def estimate(params, latents, noise, masks, domain, sigma, time):
        shape = domain.shape
        level = NoiseLevel(
            time=jnp.full(shape, time), alpha=jnp.full(shape, jnp.sqrt(1 - sigma**2)), sigma=jnp.full(shape, sigma)
        )
        x = q_sample(level, latents, noise)
        assert config is not None
        output = denoiser(config).apply(params, x, level.time, domain, masks)
        return estimate_x0(level, x, output, config.prediction)

    sums = {sigma: [] for sigma in SIGMAS}
    for padded, kept in padded_batches(scenes):
        masks, latents = encode_program(*coder)(params, *statistics, padded)
        joined = (np.asarray(padded.links) == Link.PREDECESSOR) & np.asarray(masks.lanes)[:, :, None]
        clean = None
        for sigma in SIGMAS:
            keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), len(sums[SIGMAS[-1]])))
            noise = jax.tree.map(lambda k, x: jax.random.normal(k, x.shape), PerType(*keys), latents)
            noisy = jax.tree.map(lambda x, n, s=sigma: x + s * n, latents, noise)
            if denoised and sigma:
                time = cosine_time(np.array([sigma]))[0]
                noisy = estimate(
                    model.denoiser.params, latents, noise, masks, padded.domain, np.float32(sigma), np.float32(time)
                )
            decoded = decode_program(*coder)(
                params["decoder"], *statistics, noisy, masks, padded.crop, padded.domain, None
            )
            ends = np.asarray(decoded.lanes)[:, :, (0, -1), :2]
            clean = ends if clean is None else clean
            shift = np.square(ends - clean).sum(-1)[np.asarray(masks.lanes) & kept[:, None]]
            gap = np.linalg.norm(ends[:, None, :, 0] - ends[:, :, None, 1], axis=-1)[joined & kept[:, None, None]]
            sums[sigma].append((shift.ravel(), gap))
    rows = []
    for sigma, parts in sums.items():
        shift, gap = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        rows.append(NoiseRow(sigma, float(np.sqrt(shift.mean())), float(gap.mean()), 100 * float((gap > 0.5).mean())))
    return rows


def padded_batches(scenes: Sequence[Scene]) -> Iterator[tuple[Scene, np.ndarray]]:
    """Padded batches, and True at their rows that are no repetition."""
    sizes = [(len(scene.agent_mask), len(scene.lane_mask)) for scene in scenes]
    for bucket, indices, rows in in_batches(sizes, _GROUP, _LEAST_SIZE):
        yield stack([scenes[i] for i in rows], bucket), np.arange(len(rows)) < len(indices)
