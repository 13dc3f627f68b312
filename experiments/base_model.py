"""Trains the base model on: worlds, attributes, perhaps the autoencoder, counts, then the denoiser.

    nice -n 15 python -m experiments.base_model runs/base

The same command continues where it was stopped, also within a training (Ctrl-C and SIGTERM save first). All networks
start from those that ship. The denoiser reads requests for attributes, and outlines: the kinds of all lanes and agents.
Its learning rate is constant for --steps, then falls to zero in --last-steps.
``experiments.package_model --model FOLDER/last/model --counter FOLDER/counts/model`` joins the two.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.studies.page import script_parser
from scjax.generate.model import DEFAULT_MODEL

_BUCKETS = "--config.batch.buckets=((12,16),(16,28),(32,48),(61,100))"
_AUTOENCODER = (
    "--config=autoencoder:small",
    "--config.init_from=shipped",
    "--config.model.shared_endpoints=True",
    "--config.batch.batch_size=16",
    "--config.optimizer.kind=muon",
    "--config.optimizer.warmup=200",
    "--config.loss.typical_counts=(8.0,18.0)",
    _BUCKETS,
)
_COUNTS = ("--config=counts:small", "--config.condition=attributes", "--config.steps=1500")
_DENOISER = (
    "--config=denoiser:small",
    "--config.attributes=True",
    "--config.model.blocks=3",
    "--config.model.fourier_features=16",
    "--config.model.fourier_octaves=9",
    "--config.model.relative_geometry=True",
    "--config.model.schedule=log_snr",
    "--config.model.known_embedding=True",
    "--config.batch.crops=(5.0,2.0,1.0)",
    "--config.batch.jitter_position=1.0",
    "--config.batch.jitter_heading=4.0",
    "--config.optimizer.warmup=100",
    "--config.ema_decay=0.999",
    "--config.checkpoint_every=200",
    "--config.evaluate_every=1000",
    "--config.picture_every=0",
    "--config.loss.collision=3.0",
    _BUCKETS,
)
_CONSTANT = ("--config.optimizer.schedule=constant", "--config.export_at=(1000,4000,10000,30000)")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.base_model", __doc__)
    parser.add_argument("folder", type=Path, help="receives records, models and logs")
    parser.add_argument("--worlds", type=int, default=8000)
    parser.add_argument("--seed", type=int, default=401, help="of the worlds")
    parser.add_argument("--autoencoder-steps", type=int, default=0, help="0 (the default): the autoencoder that ships")
    parser.add_argument("--steps", type=int, default=30_000, help="of the denoiser, at a constant rate")
    parser.add_argument("--last-steps", type=int, default=4000, help="of the denoiser, while the rate falls to zero")
    args = parser.parse_args(arguments)
    records, autoencoder = args.folder / "records", DEFAULT_MODEL
    scjax = (sys.executable, "-m", "scjax")
    _run(*scjax, "data", "synthetic", records, "--worlds", args.worlds, "--seed", args.seed)
    if not all((records / f"attributes-{split}.jsonl.gz").is_file() for split in ("train", "val")):
        _run(*scjax, "data", "attributes", records)
    data = f"--config.records={records}"
    if args.autoencoder_steps:
        autoencoder = args.folder / "autoencoder" / "model"
        steps = f"--config.steps={args.autoencoder_steps}"
        _run(*scjax, "train", *_AUTOENCODER, f"--workdir={autoencoder.parent}", data, steps)
    counts = f"--workdir={args.folder / 'counts'}", data, f"--config.denoiser={DEFAULT_MODEL}"
    _run(*scjax, "train", *_COUNTS, *counts)
    inputs = (*_DENOISER, data, f"--config.autoencoder={autoencoder}")
    first, last = args.folder / "denoiser", args.folder / "last"
    options = "--config.init_from=shipped", f"--config.steps={args.steps}", f"--workdir={first}"
    _run(*scjax, "train", *inputs, *_CONSTANT, *options)
    options = f"--config.init_from={first / 'model'}", f"--config.steps={args.last_steps}", f"--workdir={last}"
    _run(*scjax, "train", *inputs, *options)


def _run(*command: object) -> None:
    """Runs a command, and ends this one with its exit code if it fails."""
    words = [str(word) for word in command]
    print(" ".join(words[2:]), file=sys.stderr, flush=True)
    if code := subprocess.run(words, check=False).returncode:
        sys.exit(code)


if __name__ == "__main__":
    main()
