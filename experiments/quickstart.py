"""The whole product in a few minutes on a laptop: python -m experiments.quickstart

Makes some synthetic worlds, trains the tiny autoencoder and the tiny denoiser on their scenes, samples new ones and
saves the picture. ``--smoke`` runs the same chain with a handful of steps (the picture is then noise); ``--longer 3``
trains with three times the steps of the tiny variants.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from experiments import sample
from experiments.configs import autoencoder, denoiser
from experiments.train import train
from scjax.data.build import build
from scjax.data.synthetic.source import Worlds
from scjax.devices import use_every_core


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.quickstart", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("runs/quickstart"), help="folder for everything it makes")
    parser.add_argument("--smoke", action="store_true", help="a handful of steps, to see that everything runs")
    parser.add_argument("--longer", type=float, default=0.65, metavar="FACTOR",
                        help="steps, times those of the tiny variants (default: %(default)s)")  # fmt: skip
    args = parser.parse_args(arguments)
    if args.longer <= 0:
        parser.error(f"--longer must be positive, not {args.longer:g}")
    use_every_core()
    start = time.perf_counter()

    def told(text: str) -> None:
        print(f"[{time.perf_counter() - start:5.0f} s] {text}", flush=True)

    told("making a synthetic world")
    build(Worlds(0, 8 if args.smoke else 48), args.out / "records")

    for stage, config in (("autoencoder", autoencoder.get_config("tiny")), ("denoiser", denoiser.get_config("tiny"))):
        told(f"training the {stage}")
        config.records = str(args.out / "records")
        config.batch.buckets = ((16, 32),)  # one program to compile; what lies farthest off is left out
        # Minutes are few: one window, each tile as it was recorded, and nothing else to compile.
        config.batch.layouts, config.batch.jitter_position, config.batch.jitter_heading = (1.0, 0.0, 0.0), 0.0, 0.0
        config.evaluate_every = config.picture_every = 0
        config.steps = round(config.steps * args.longer)
        config.optimiser.warmup = min(config.optimiser.warmup, config.steps // 5)
        if stage == "denoiser":
            config.autoencoder = str(args.out / "autoencoder" / "model")
        if args.smoke:
            config.steps = config.log_every = 4
            config.optimiser.warmup = 1
        train(config, args.out / stage)

    told("sampling")
    sample.main([f"--model={args.out}/denoiser/model", f"--out={args.out}/samples", "-n", "4" if args.smoke else "12"])
    told(f"done: look at {args.out}/samples/scenes.png")


if __name__ == "__main__":
    main()
