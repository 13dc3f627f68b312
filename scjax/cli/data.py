"""scjax data: the commands of ``python -m scjax.data`` under the same roof."""

from __future__ import annotations

import click


@click.command(context_settings={"ignore_unknown_options": True, "help_option_names": []}, add_help_option=False)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def data(arguments) -> int:
    """Builds, makes, captions and embeds training records; `scjax data --help` lists the commands."""
    from scjax.data.__main__ import main

    return main(list(arguments) or ["--help"])
