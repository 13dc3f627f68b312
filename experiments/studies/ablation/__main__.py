"""Which way to condition works best?

    python -m experiments.studies.ablation --config=experiments/studies/ablation/config.py --workdir=runs/ablation

Trains every mechanism from one base on the same batches, with several seeds, on texts and on ray-cast images;
samples held-out scenes with their own conditions and with shuffled ones. Writes ablation.md, ablation.json
and ablation.png into WORKDIR, or to --config.out=docs/results/ablation. The same command continues an interrupted
ablation.

--config.seeds="(1,)" makes one seed; --config.more="('ABLATION.JSON',)" adds runs from elsewhere to the report. Runs of
one seed and modality need the same base. Such small models gain little from a second core: with one --config.base, run
one process per modality, each with its own WORKDIR and its own core (taskset).

Fields: experiments/studies/ablation/config.py.
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
from experiments.studies.page import command_line
from scjax.nn.startup import start_jax

_CONFIG = config_flags.DEFINE_config_file("config", None, "Config file and variant.", lock_config=True)
_WORKDIR = flags.DEFINE_string("workdir", None, "Folder of runs, samples and the report.")
flags.mark_flags_as_required(["config", "workdir"])


def main(_) -> None:
    logging.set_verbosity(logging.FATAL)
    start_jax()
    try:
        report = ablate(_CONFIG.value, Path(_WORKDIR.value), command_line("ablation", None))
    except (ValueError, FloatingPointError, OSError) as error:
        sys.exit(f"experiments.studies.ablation: {error}")
    except KeyboardInterrupt:
        report = None
    print(report.read_text() if report else "stopped: the same command continues")


if __name__ == "__main__":
    app.run(main)
