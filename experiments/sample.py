"""Samples scenes from a trained model: python -m experiments.sample --model=runs/denoiser/model --out=samples -n 16

Writes scenes.npz (all scenes, metres), scenes.json and scenes.png (a labelled grid) into the output folder.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import jax
import numpy as np

import scjax
from scjax.diffusion.samplers import SAMPLERS
from scjax.nn.startup import start_jax
from scjax.scene import Crop
from scjax.scene.io import load_npz, save_json, save_npz
from scjax.viz import grid


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.sample", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", required=True, help="model folder: WORKDIR/model of a denoiser training")
    parser.add_argument("--out", type=Path, default=Path("samples"), help="output folder (default: samples)")
    parser.add_argument("-n", type=int, default=16, help="number of scenes (default: 16)")
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument("--lanes", type=int, help="lanes per scene; drawn from the data's table by default")
    parser.add_argument("--agents", type=int, help="agents per scene, ego included; drawn by default")
    parser.add_argument("--domain", help="data set or city, one of the model's; drawn by default")
    parser.add_argument(
        "--crop", choices=[crop.name.lower() for crop in Crop], default="centered", help="window (default: centered)"
    )
    parser.add_argument("--known", type=Path, help="npz with one scene whose lanes and agents are kept")
    parser.add_argument("--sampler", choices=SAMPLERS, help="default: ddpm, of a rectified flow heun")
    parser.add_argument("--steps", type=int, help="sampling steps (default: the sampler's own)")
    parser.add_argument("--guidance", type=float, help="guidance weight; 1 is none")
    args = parser.parse_args(arguments)
    start_jax()
    try:
        scenes = run(args)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.sample: {error}")
    print(f"{scenes.batch_shape[0]} scenes in {args.out}: scenes.png, scenes.npz, scenes.json")


def run(args: argparse.Namespace) -> scjax.Scene:
    """Samples and writes; returns the batch."""
    condition = scjax.Condition(
        num_lanes=args.lanes,
        num_agents=args.agents,
        domain=args.domain,
        crop=Crop[args.crop.upper()],
        known=load_npz(args.known) if args.known else None,
    )
    model = scjax.load(args.model)
    start = time.perf_counter()
    scenes = scjax.sample(
        jax.random.key(args.seed),
        condition,
        model=model,
        num_scenes=args.n,
        num_steps=args.steps,
        guidance=args.guidance,
        sampler=args.sampler,
    )
    print(f"sampled in {time.perf_counter() - start:.1f} s, compilation included", file=sys.stderr)
    args.out.mkdir(parents=True, exist_ok=True)
    save_npz(scenes, args.out / "scenes.npz")
    save_json(scenes, args.out / "scenes.json")
    singles = [scenes[i] for i in range(args.n)]
    titles = [f"{int(np.sum(s.lane_mask))} lanes, {int(np.sum(s.agent_mask))} agents" for s in singles]
    grid(singles, columns=min(4, args.n), titles=titles, path=args.out / "scenes.png")
    return scenes


if __name__ == "__main__":
    main()
