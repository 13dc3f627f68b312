"""How fast is a training step? python -m benchmarks.train_step [autoencoder|unconditional|text|image] --batch 16

Prints scenes/s (real scenes of the reference workload), GFLOP/s of useful work, its share of the measured rooflines,
compile time apart, peak memory, and the ratio against the float32 PyTorch reference of the same batch.
"""

from __future__ import annotations

import argparse
import json
import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import flops, workload
from experiments.state import initial, training_step
from scjax import representation as presets
from scjax.devices import use_every_core
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.optimiser import adamw
from scjax.diffusion.schedule import cosine_schedule
from scjax.memory import keep_memory
from scjax.models.autoencoder import config as autoencoder_sizes
from scjax.models.autoencoder.loss import loss
from scjax.models.autoencoder.model import autoencoder, noise_like
from scjax.models.denoiser import config as denoiser_sizes
from scjax.models.denoiser.context import ImageFeatures, TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.models.nodes import Nodes

# Official PyTorch code at these sizes on such a machine (2 cores), scenes/s by batch, float32.
REFERENCE = {
    "autoencoder": {16: 9.7, 64: 5.5},
    "unconditional": {16: 15.5},
    "text": {16: 8.7},
    "image": {16: 12.3},
}
TEXT = denoiser_sizes.TextCondition(width=4096)
IMAGE = denoiser_sizes.ImageCondition()
CONTEXT = {"unconditional": 0, "text": 512, "image": 392}


def denoiser_config(kind: str, compute: str) -> denoiser_sizes.DenoiserConfig:
    """The small denoiser of the reference, with its condition."""
    condition = {"unconditional": None, "text": TEXT, "image": IMAGE}[kind]
    return denoiser_sizes.small(condition, compute=compute)


def features(kind: str, scenes: int):
    """Random condition features, all text tokens valid."""
    rng = np.random.default_rng(2)
    if kind == "text":
        tokens = rng.normal(size=(scenes, 512, TEXT.width)).astype(np.float32)
        return TextFeatures(tokens=tokens, mask=np.ones((scenes, 512), bool))
    if kind == "image":
        dino = rng.normal(size=(scenes, IMAGE.channels, *IMAGE.grid)).astype(np.float32)
        return ImageFeatures(dino=dino, depth=rng.random((scenes, 384, 672), np.float32))
    return None


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.train_step", description=__doc__)
    parser.add_argument("kind", choices=list(REFERENCE), nargs="?", default="autoencoder")
    parser.add_argument("--batch", type=int, default=16, help="scenes a step (default: 16)")
    parser.add_argument("--compute", choices=["float32", "bfloat16"], default="float32")
    parser.add_argument("--repeats", type=int, default=3, help="timed passes over the workload")
    parser.add_argument("--smoke", action="store_true", help="one small batch, to see that it runs")
    args = parser.parse_args(arguments)
    keep_memory()
    use_every_core()
    scenes = args.batch if args.smoke else max(64, args.batch)
    parts = workload.batches(args.batch, scenes)

    optimiser = adamw(learning_rate=1e-4, steps=1000)
    if args.kind == "autoencoder":
        config = autoencoder_sizes.small(compute=args.compute)
        network, representation = autoencoder(config), presets.scjax()

        def objective(params, batch, key):
            tokens = representation.tokens(batch)
            posterior, decoded = network.apply(params, tokens, noise_like(key, tokens, config), method="reconstruct")
            return loss(decoded, posterior, tokens, official_lane_count=False, balanced_links=True)

        def useful(lanes, agents):
            return 3 * flops.autoencoder_forward(config, lanes, agents)

        inputs = parts
    else:
        config = denoiser_config(args.kind, args.compute)
        network, schedule = denoiser(config), cosine_schedule()

        def objective(params, batch, key):
            return training_loss(
                network, params, schedule, batch, key, null_label=config.null_label, prediction=config.prediction
            )

        def useful(lanes, agents):
            return 3 * flops.denoiser_forward(config, lanes, agents, CONTEXT[args.kind])

        inputs = [_latents(part, config, args.kind) for part in parts]

    # The step of experiments.train itself, with its moving average and its use of every core.
    step = training_step(objective, optimiser, ema_decay=0.999, seed=1, batch_size=args.batch)
    state = initial(network.init(jax.random.key(0)), optimiser)

    def run() -> None:
        nonlocal state
        for batch in inputs:
            state, metrics = step(state, batch)
            jax.block_until_ready(metrics)

    start = time.perf_counter()
    run()
    first_pass = time.perf_counter() - start
    seconds = workload.best_seconds(run, 1 if args.smoke else args.repeats)
    programs = {tuple(leaf.shape for leaf in jax.tree.leaves(batch)) for batch in inputs}
    work = sum(useful(lanes, agents) for lanes, agents in workload.counts(scenes)) / seconds / 1e9
    roofs = workload.rooflines()
    reference = REFERENCE[args.kind].get(args.batch)
    row = {
        "step": args.kind, "batch": args.batch, "compute": args.compute, "scenes/s": scenes / seconds,
        "reference": reference or "-", "ratio": scenes / seconds / reference if reference else "-",
        "GFLOP/s": work, **{f"share of {name}": work / roof for name, roof in roofs.items()},
        "programs": len(programs), "compile s": first_pass - seconds, "peak GB": workload.peak_memory_gb(),
    }  # fmt: skip
    print(workload.table([row]))
    print(json.dumps({**row, "rooflines": roofs, "machine": workload.machine()}))


def _latents(scenes, config, kind: str) -> LatentBatch:
    rng = np.random.default_rng(3)
    masks = Nodes(agents=jnp.asarray(scenes.agent_mask), lanes=jnp.asarray(scenes.lane_mask))
    widths = Nodes(agents=config.agent_latent, lanes=config.lane_latent)
    latents = jax.tree.map(
        lambda mask, width: jnp.asarray(rng.normal(size=(*mask.shape, width)), jnp.float32), masks, widths
    )
    return LatentBatch(
        latents=latents, masks=masks, given=jax.tree.map(jnp.zeros_like, masks),
        label=jnp.zeros(len(scenes.layout), jnp.int32), condition=features(kind, len(scenes.layout)),
    )  # fmt: skip


if __name__ == "__main__":
    main()
