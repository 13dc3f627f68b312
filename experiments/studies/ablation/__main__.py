"""Which way to condition works best?

    python -m experiments.studies.ablation --config=experiments/studies/ablation/config.py --workdir=runs/ablation

Trains every mechanism from one base on the same batches, with several seeds, on texts and on what stands in for images;
samples held-back conditions with each, once with a scene's own condition and once with another's; and writes a table,
its JSON and a plot: ablation.md, ablation.json, ablation.png. The same command goes on where it was stopped, and
leaves alone what is finished; --config.seeds="(1,)" makes one seed, --config.more="('ABLATION.JSON',)" reports it
beside others made elsewhere, of which only those of equal seed and kind need the same base. So small a model gains
little from a second core: faster is, with one --config.base, a process a kind, each in a work folder of its own and on
its own core (taskset). Fields: experiments/studies/ablation/config.py.
"""

from __future__ import annotations

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory

    keep_memory()

import sys
from pathlib import Path

from absl import app, flags, logging
from ml_collections import config_flags

from experiments.studies.ablation.run import ablate
from scjax.nn.startup import start_jax

_CONFIG = config_flags.DEFINE_config_file("config", None, "Config file and variant.", lock_config=True)
_WORKDIR = flags.DEFINE_string("workdir", None, "Folder of runs, samples and the report.")
flags.mark_flags_as_required(["config", "workdir"])


def main(_) -> None:
    logging.set_verbosity(logging.FATAL)
    start_jax()
    try:
        report = ablate(_CONFIG.value, Path(_WORKDIR.value))
    except (ValueError, FloatingPointError, OSError) as error:
        sys.exit(f"experiments.studies.ablation: {error}")
    except KeyboardInterrupt:
        report = None
    print(report.read_text() if report else "stopped: the same command continues")


if __name__ == "__main__":
    app.run(main)
