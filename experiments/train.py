"""Trains one network: python -m experiments.train --config=experiments/configs/NAME.py:VARIANT --workdir=runs/x

The same as ``scjax train`` (scjax/train/launch.py has all options). Configs: autoencoder, then denoiser (which reads
the first one's exported model), for prompts a denoiser with --config.condition=text and then counts.
"""

from __future__ import annotations

import sys

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory_by_option

    keep_memory_by_option(sys.argv[1:])

from scjax.train.launch import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "experiments.train"))
