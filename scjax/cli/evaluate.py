"""``scjax evaluate``: compares sets of scenes, a model's or others', with reference scenes."""

from __future__ import annotations

from pathlib import Path

import click

_HELP = """Measures scenes of several methods against reference scenes and writes a report.

\b
scjax evaluate --config=baselines --workdir=runs/e --config.reference=npz:runs/scenes
--config.retrieval_set=npz:runs/train
scjax evaluate --config=standard --workdir=runs/e --config.model=runs/denoiser/model

CONFIG is a variant (standard, baselines, placement, prompts, controllability, mechanisms, collisions, generalization)
or
FILE.py:VARIANT. Every field can be changed with --config.FIELD=VALUE; fields are listed in scjax/evaluate/config.py. A
further method: --config.more="name=mine, model=runs/x/model, request=prompt". WORKDIR receives report.html,
report.json and report.csv. The same command continues an interrupted evaluation.
"""


@click.command(help=_HELP, context_settings={"ignore_unknown_options": True})
@click.option("--config", "config_text", required=True, metavar="CONFIG", help="Variant, or FILE.py:VARIANT.")
@click.option("--workdir", required=True, type=click.Path(path_type=Path), help="Folder of scenes, parts and report.")
@click.argument("overrides", nargs=-1, type=click.UNPROCESSED)
def evaluate(config_text: str, workdir: Path, overrides: tuple[str, ...]) -> None:
    from scjax.cli.config_flags import load_config
    from scjax.evaluate.config import get_config
    from scjax.evaluate.run import run_evaluation
    from scjax.nn.startup import start_jax

    config = load_config(config_text, get_config, overrides)
    start_jax()
    report = run_evaluation(config, workdir)
    waiting = "this shard is done: run all shards once more, the last one writes the report"
    click.echo(f"report: {report}" if report else waiting)
