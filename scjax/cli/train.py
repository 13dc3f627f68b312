"""scjax train: trains an autoencoder, a denoiser or counts."""

from __future__ import annotations

import click


@click.command(
    "train", context_settings={"ignore_unknown_options": True, "help_option_names": []}, add_help_option=False
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
@click.pass_obj
def train_command(is_debug: bool | None, arguments: tuple[str, ...]) -> int:
    """Trains a network on records; `scjax train --help` has the options and configs."""
    from scjax.train.launch import DEBUG, HELP_OPTIONS, main
    from scjax.train.malloc import keep_memory_by_option

    arguments = arguments or ("--help",)
    if not HELP_OPTIONS & set(arguments):
        keep_memory_by_option(arguments)
    return main([*arguments, DEBUG] if is_debug else arguments, "scjax train")
