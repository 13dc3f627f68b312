"""Weights of the official release for scjax: python -m scjax.convert official CKPT OUT"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from scjax.convert.official import convert_checkpoint
from scjax.generate.model import load_model, save_model
from scjax.nn.functional import count


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m scjax.convert", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    official = commands.add_parser(
        "official",
        help="a checkpoint of the official PyTorch release",
        description="Maps an official state dict onto scjax parameters, strictly: unexpected, missing and misshapen "
        "entries are listed and nothing is written. The autoencoder and the denoiser come in separate files: convert "
        "both into the same OUT.",
    )
    official.add_argument("checkpoint", type=Path, help="safetensors, or a PyTorch file (needs scjax[convert])")
    official.add_argument("out", type=Path, help="model folder for scjax.load; an existing one is completed")
    official.add_argument(
        "--heads",
        type=int,
        nargs=2,
        metavar=("LANE", "AGENT"),
        help="attention heads, where they are not those of the release (shapes do not tell them)",
    )
    args = parser.parse_args(arguments)
    try:
        into = load_model(args.out) if args.out.exists() else None
        heads = (
            None if args.heads is None else dict.fromkeys(("autoencoder", "denoiser"), (args.heads[0], args.heads[1]))
        )
        model = convert_checkpoint(args.checkpoint, into=into, heads=heads)
        save_model(model, args.out)
    except (ValueError, OSError) as error:
        sys.exit(f"scjax.convert: {error}")
    for name in ("autoencoder", "denoiser"):
        network = model.components.get(name)
        print(f"{name}: {f'{count(network.params):,} parameters' if network else 'not in this model'}")
    print(f"model folder: {args.out}")


if __name__ == "__main__":
    main()
