"""Trains the base model: worlds, captions, attributes, the autoencoder, counts, then the denoiser.

    nice -n 15 python -m experiments.base_model runs/base

The same command continues where it was stopped, also within a training (Ctrl-C and SIGTERM save first). The
autoencoder starts from the one that ships and learns the wider world, with lane ends that links join as one point.
The denoiser starts from the one that ships, with noise levels down to 0.005 (docs/results/low_noise.md), and reads
captions, requests for attributes, and kinds of lanes and agents. Its learning rate is constant, so that it can go on
as long as there is time: a last training with a rate that falls to zero starts from its model.
``experiments.package_model --model DENOISER --counter COUNTS`` joins the two.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from experiments.studies.page import script_parser

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
    "--config.condition=text",
    "--config.attributes=True",
    "--config.model.blocks=3",
    "--config.model.fourier_features=16",
    "--config.model.fourier_octaves=9",
    "--config.model.relative_geometry=True",
    "--config.model.schedule=log_snr",
    "--config.batch.crops=(6.0,1.0,1.0)",
    "--config.batch.jitter_position=1.0",
    "--config.batch.jitter_heading=4.0",
    "--config.batch.text_slots=64",
    "--config.optimizer.schedule=constant",
    "--config.optimizer.warmup=100",
    "--config.ema_decay=0.999",
    "--config.checkpoint_every=200",
    "--config.export_at=(1000,3000,10000,30000)",
    "--config.evaluate_every=1000",
    "--config.picture_every=4000",
    _BUCKETS,
)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.base_model", __doc__)
    parser.add_argument("folder", type=Path, help="receives records, models and logs")
    parser.add_argument("--worlds", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=101, help="of the worlds")
    parser.add_argument("--autoencoder-steps", type=int, default=6000)
    parser.add_argument("--denoiser-steps", type=int, default=100_000)
    parser.add_argument("--autoencoder", type=Path, help="model folder of a trained autoencoder to use instead")
    args = parser.parse_args(arguments)
    records, start = args.folder / "records", args.folder / "start"
    autoencoder = args.autoencoder or args.folder / "autoencoder" / "model"
    scjax = (sys.executable, "-m", "scjax")
    _run(*scjax, "data", "synthetic", records, "--worlds", args.worlds, "--seed", args.seed)
    if not all((records / f"attributes-{split}.jsonl.gz").is_file() for split in ("train", "val")):
        _run(*scjax, "data", "attributes", records)
    if not all((records / f"text-{split}.npz").is_file() for split in ("train", "val")):
        _run(*scjax, "data", "caption", records, "--texts", 2)
        _run(*scjax, "data", "embed", records)
    if not autoencoder.is_dir():
        steps = f"--config.steps={args.autoencoder_steps}"
        _run(*scjax, "train", *_AUTOENCODER, f"--workdir={autoencoder.parent}", f"--config.records={records}", steps)
    if not start.is_dir():
        _run(sys.executable, "-m", "benchmarks.low_noise.base", start, "--octaves", 9, "--keep-text")
    counts = args.folder / "counts"
    if not (counts / "model").is_dir():
        base = f"--config.denoiser={start}"
        _run(*scjax, "train", *_COUNTS, f"--workdir={counts}", f"--config.records={records}", base)
    inputs = f"--config.records={records}", f"--config.autoencoder={autoencoder}", f"--config.init_from={start}"
    workdir, steps = f"--workdir={args.folder / 'denoiser'}", f"--config.steps={args.denoiser_steps}"
    _run(*scjax, "train", *_DENOISER, *inputs, workdir, steps)


def _run(*command: object) -> None:
    """Runs a command, and ends this one with its exit code if it fails."""
    words = [str(word) for word in command]
    print(" ".join(words[2:]), file=sys.stderr, flush=True)
    if code := subprocess.run(words, check=False).returncode:
        sys.exit(code)


if __name__ == "__main__":
    main()
