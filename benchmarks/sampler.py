"""How fast is sampling? python -m benchmarks.sampler [unconditional|text|image] --batch 8

100 steps with guidance 4 (two branches) on scenes of the workload, without decoding. Condition and modulation are
computed once (--per-step: modulation in every step). Prints seconds per scene; ``benchmarks.peer`` compares with the
official release.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks import workload
from benchmarks.steps import CONTEXT, KINDS, denoiser_config, features
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE, MAX_PRECOMPUTED
from scjax.diffusion.denoise_fn import denoise_fn, prepare_denoiser_inputs
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import make_schedule, resolve_sampler
from scjax.diffusion.samplers.loop import sample_latents
from scjax.models import flops
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.nn.functional import Params
from scjax.nn.sharding import spread, use_every_core
from scjax.scene import Scene
from scjax.scene.per_type import PerType


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sampler", description=__doc__)
    parser.add_argument("kind", choices=KINDS[1:], nargs="?", default="unconditional")
    parser.add_argument("--batch", type=int, default=8, help="scenes at once (default: 8)")
    parser.add_argument("--scenes", type=int, default=0, help="scenes of the workload (default: 64; 8 at batch 1)")
    parser.add_argument("--sampler", choices=["ddpm", "ddim", "dpm++"], default="ddpm")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--per-step", action="store_true", help="compute the modulation in every step")
    parser.add_argument("--compute", choices=["float32", "bfloat16"], default="float32")
    parser.add_argument("--smoke", action="store_true", help="two steps of one batch, to see that it runs")
    args = parser.parse_args(arguments)
    use_every_core()
    steps = 2 if args.smoke else args.steps
    parts = workload.batches(args.batch)
    num_scenes = args.batch if args.smoke else args.scenes or (64 if args.batch > 1 else 8)
    parts = workload.evenly(parts, max(num_scenes // args.batch, 1))

    config = denoiser_config(args.kind, args.compute)
    sampler = guided_sampler(config, args.sampler, steps, max_precomputed=0 if args.per_step else MAX_PRECOMPUTED)
    start = time.perf_counter()
    run = sampling_pass(sampler, args.kind, parts)
    compile_seconds = time.perf_counter() - start
    start = time.perf_counter()
    run()
    seconds = time.perf_counter() - start
    scenes = len(parts) * args.batch
    rate = sum(useful_flops(config, args.kind, steps, part) for part in parts) / seconds / 1e9

    roofs = workload.rooflines()
    row = {
        "sampling": args.kind,
        "batch": args.batch,
        "sampler": args.sampler,
        "steps": steps,
        "compute": args.compute,
        "s/scene": seconds / scenes,
        "GFLOP/s": rate,
        **{f"share of {name}": rate / roof for name, roof in roofs.items()},
        "scenes": scenes,
        "programs": len({part.lane_mask.shape for part in parts}),
        "compile s": compile_seconds,
        "peak GB": workload.peak_memory_gb(),
    }
    print(workload.table([row]))
    print(json.dumps({**row, "rooflines": roofs, "machine": workload.machine()}))


def guided_sampler(
    config: DenoiserConfig, name: str, steps: int, max_precomputed: int = MAX_PRECOMPUTED
) -> tuple[Callable[..., Any], Params]:
    """A function (parameters, masks, condition, keys) -> latents, sampled with guidance, and its initial parameters."""
    network, sampler = denoiser(config), resolve_sampler(name, config.prediction)
    schedule = make_schedule(sampler, config.prediction, steps)

    def run(params, masks: PerType, condition, keys):
        inputs = prepare_denoiser_inputs(
            network,
            config,
            params,
            jnp.zeros(keys.shape, jnp.int32),
            masks,
            times=schedule.levels.time,
            guided=True,
            features=condition,
            max_precomputed=max_precomputed,
        )
        denoise = denoise_fn(
            network,
            params,
            inputs,
            times=schedule.levels.time,
            guidance=Guidance(),
            guidance_scale=DEFAULT_GUIDANCE_SCALE,
        )
        return sample_latents(
            denoise,
            schedule,
            keys,
            masks,
            sampler=sampler,
            prediction=config.prediction,
            latent_widths=PerType(agents=config.agent_latent, lanes=config.lane_latent),
            max_tokens=PerType(agents=config.max_agents, lanes=config.max_lanes),
        )

    return run, network.init(jax.random.key(0))


def sampling_pass(sampler: tuple[Callable[..., Any], Params], kind: str, parts: Sequence[Scene]) -> Callable[[], None]:
    """One pass over batches; compiles their programs."""
    run, params = sampler
    jitted = jax.jit(spread(run, shared=1))  # as scjax.sample does
    jobs, programs = [], {}
    for part in parts:
        inputs = (params, *workload_inputs(part, kind))
        shape = (part.agent_mask.shape, part.lane_mask.shape)
        if shape not in programs:
            programs[shape] = jitted.lower(*inputs).compile()
        jobs.append((programs[shape], inputs))

    def one_pass() -> None:
        for program, inputs in jobs:
            jax.block_until_ready(program(*inputs))

    return one_pass


def workload_inputs(scenes: Scene, kind: str) -> tuple[PerType, Any, jax.Array]:
    """Masks, condition and keys of a batch: the inputs of ``guided_sampler``'s function."""
    masks = PerType(agents=jnp.asarray(scenes.agent_mask), lanes=jnp.asarray(scenes.lane_mask))
    number = len(scenes.crop)
    return masks, features(kind, number), jax.random.split(jax.random.key(1), number)


def useful_flops(config: DenoiserConfig, kind: str, steps: int, scenes: Scene) -> float:
    """Closed-form FLOPs of real lanes and agents; the unconditional branch reads no condition."""
    counts = zip(scenes.num_lanes.tolist(), scenes.num_agents.tolist(), strict=True)
    return steps * sum(
        flops.denoiser_forward(config, lanes, agents, context, cached=True)
        for lanes, agents in counts
        for context in (CONTEXT[kind], 0)
    )


if __name__ == "__main__":
    main()
