"""Measures scenes: python -m scjax.evaluate --config=scjax/evaluate/config.py:standard --workdir=runs/e

Rows of scenes (a model's, other models', baselines) are compared with reference scenes, beside the floor that two sets
of real scenes have. Writes report.html (one file, with pictures), report.json and report.csv into the work folder. The
same command goes on where it was stopped. Variants and fields: scjax/evaluate/config.py.
"""

from __future__ import annotations

import sys
from pathlib import Path

from absl import app, flags, logging
from ml_collections import config_flags

from scjax.evaluate.run import evaluate
from scjax.nn.startup import start_jax

_CONFIG = config_flags.DEFINE_config_file("config", None, "Config file and variant.", lock_config=True)
_WORKDIR = flags.DEFINE_string("workdir", None, "Folder of the evaluation: made scenes, measured parts, the report.")
flags.mark_flags_as_required(["config", "workdir"])


def main(_) -> None:
    logging.set_verbosity(logging.FATAL)
    start_jax()
    try:
        report = evaluate(_CONFIG.value, Path(_WORKDIR.value))
    except (ValueError, OSError) as error:
        sys.exit(f"scjax.evaluate: {error}")
    print(
        f"report: {report}"
        if report
        else "this shard is done: run all shards once more, the last one writes the report"
    )


if __name__ == "__main__":
    app.run(main)
