"""Why are raw samples open at their connections, and what closes them?

    python -m benchmarks.low_noise NAME=MODEL ... --records RECORDS --out FOLDER

For each model folder: how far noise in the latents moves lane ends, how far one evaluation of the denoiser brings them
back, and how sound samples are at the counts of held-out records: single draws of the model's temperature, without
guidance, energies and repair. Samples are measured twice: as drawn, and with ``models.shared_endpoints``. The judge of
``SCJAX_SHARED/prompts`` measures. FOLDER keeps a file a model and number of steps, so that the command continues where
it was interrupted.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import scjax
from benchmarks.low_noise.heads import head_errors
from benchmarks.low_noise.judge import measure_soundness
from benchmarks.low_noise.noise import noise_rows, posterior_deviations
from scjax.evaluate.requests import counts_request
from scjax.evaluate.sources import RecordScenes
from scjax.generate.model import Model
from scjax.generate.reconstruct import reconstruct
from scjax.models.shared_endpoints import share_endpoints
from scjax.nn.startup import start_jax
from scjax.scene import Scene, stack, unpadded
from scjax.scene.files import write_text

_NOISE_SCENES = 64
MAX_AGENTS, MAX_LANES = 32, 48  # the scenes of the shipped model's training


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.low_noise",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("models", nargs="+", metavar="NAME=MODEL", help="model folders by the names of their rows")
    parser.add_argument("--records", required=True, help="record folder with a val split")
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--scenes", type=int, default=256, help="samples (default: 256)")
    parser.add_argument("--num-steps", type=int, nargs="+", default=[25, 100], help="(default: 25 100)")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(arguments)
    scenes, domains = held_out(args.records, args.scenes)
    args.out.mkdir(parents=True, exist_ok=True)
    for text in args.models:
        name, _, folder = text.partition("=")
        model = scjax.load(folder)
        once(args.out / f"{name}-noise.json", lambda m=model: noise_tables(m, scenes))
        for steps in args.num_steps if "denoiser" in model.components else ():
            once(
                args.out / f"{name}-{steps}-{args.seed}.json",
                lambda m=model, n=steps: sample_table(m, scenes, domains, n, args.seed),
            )


def held_out(records: str, number: int) -> tuple[list[Scene], list[str | None]]:
    """Evenly spaced held-out scenes of at most ``MAX_AGENTS`` and ``MAX_LANES``, and their domains."""
    source = RecordScenes(records, "val")
    rows = np.linspace(0, len(source.clusters) - 1, len(source.clusters)).astype(int)
    scenes = [
        scene
        for scene in source.read(rows.tolist())
        if len(scene.agent_mask) <= MAX_AGENTS and len(scene.lane_mask) <= MAX_LANES
    ]
    chosen = np.unique(np.linspace(0, len(scenes) - 1, min(number, len(scenes))).astype(int))
    scenes = [scenes[i] for i in chosen]
    return scenes, [source.domains[int(scene.domain)] for scene in scenes]


def noise_tables(model: Model, scenes: Sequence[Scene]) -> dict[str, Any]:
    """The effect of noise with and without denoising, the posterior, and the soundness of reconstructions."""
    scenes = [model.codec.select(scene) for scene in scenes]
    decoded = reconstruct(model, scenes)
    few = scenes[:: max(len(scenes) // _NOISE_SCENES, 1)]
    tables: dict[str, Any] = {
        "recorded": dataclasses.asdict(measure_soundness(scenes)),
        "reconstructed": dataclasses.asdict(measure_soundness(decoded)),
        "reconstructed, shared endpoints": dataclasses.asdict(measure_soundness(shared(decoded))),
        "posterior": posterior_deviations(model, few),
        "noisy": [dataclasses.asdict(row) for row in noise_rows(model, few, denoised=False)],
    }
    if "denoiser" in model.components:
        if model.denoiser.config.relative_geometry:
            tables["heads"] = head_errors(model, few)
        tables["denoised"] = [dataclasses.asdict(row) for row in noise_rows(model, few, denoised=True)]
    return tables


def sample_table(
    model: Model, scenes: Sequence[Scene], domains: Sequence[str | None], steps: int, seed: int
) -> dict[str, Any]:
    """Soundness of samples as drawn and with shared endpoints, and seconds a scene with compiling."""
    conditions = [counts_request(model, *pair) for pair in zip(scenes, domains, strict=True)]
    start = time.perf_counter()
    options: dict[str, Any] = {"guidance": 1.0, "energy_guidance": False, "padded_size": (32, 32)}
    samples = scjax.sample(jax.random.key(seed), conditions, model=model, num_steps=steps, **options)
    seconds = (time.perf_counter() - start) / len(samples)
    return {
        "seconds": seconds,
        "samples": dataclasses.asdict(measure_soundness(samples)),
        "samples, shared endpoints": dataclasses.asdict(measure_soundness(shared(samples))),
    }


def shared(scenes: Sequence[Scene]) -> list[Scene]:
    """The scenes with ``share_endpoints``; in batches of one shape."""
    share, size = jax.jit(share_endpoints), (MAX_AGENTS, MAX_LANES)
    results = []
    for start in range(0, len(scenes), 32):
        part = list(scenes[start : start + 32])
        batch = share(stack(part + [part[0]] * (32 - len(part)), size)).to_numpy()
        results += [unpadded(batch[i]) for i in range(len(part))]
    return results


def once(path: Path, table: Any) -> None:
    """Writes the table and prints it, unless there is one."""
    if not path.exists():
        write_text(path, json.dumps(table(), indent=1))
    print(path.stem, path.read_text(encoding="utf-8"), flush=True)


if __name__ == "__main__":
    start_jax()
    main()
