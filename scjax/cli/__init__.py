"""The command ``scjax``: scenes from prompts, and what files and models hold.

Exit codes: 0 done, 1 refused (one line on stderr says why), 2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

import click

from scjax.cli.attributes import attributes_command
from scjax.cli.data import data
from scjax.cli.demo import demo
from scjax.cli.edit import edit_command
from scjax.cli.evaluate import evaluate
from scjax.cli.export import export_command
from scjax.cli.generate import generate
from scjax.cli.inspect import caption, info, schema
from scjax.cli.outpaint import outpaint_command
from scjax.cli.place import place_command
from scjax.cli.plot import plot_command
from scjax.cli.read import read_command
from scjax.cli.render import render_command
from scjax.cli.simulate import simulate_command
from scjax.cli.train import train_command


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="scjax")
def cli() -> None:
    """Generates driving scenes from text.

    \b
    scjax demo                                   one picture of scenes for six prompts
    scjax generate "a T-junction with two cars"  scenes for your own prompts
    scjax simulate "a busy crossing"             traffic that moves, as an animation
    scjax outpaint "a street in a town"          a map of 200 m that grows from it
    scjax info                                   domains, sizes and training of the model

    Errors are one line; --debug, anywhere in a command, shows their trace.
    """


DEBUG = "--debug"
"""Anywhere among the arguments: errors show their trace."""

for command in (
    *(demo, generate, simulate_command, outpaint_command, place_command, edit_command, read_command),
    *(evaluate, caption, attributes_command, plot_command, render_command, export_command),
    *(data, train_command, info, schema),
):
    cli.add_command(command)


def _one_line(error: Exception) -> str:
    """The message of an error, without line breaks and not longer than a screen."""
    text = " ".join(str(error).split())
    return text if len(text) <= 1000 else f"{text[:1000]}..."


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point; an error that a user can cause is one line on stderr.

    Args:
      arguments: the words after the command's name; by default those of ``sys.argv``.
    """
    warnings.showwarning = lambda message, *_: click.echo(f"scjax: warning: {message}", err=True)
    words = list(sys.argv[1:] if arguments is None else arguments)
    is_debug = DEBUG in words
    words = [word for word in words if word != DEBUG]
    try:
        code = cli.main(words, prog_name="scjax", standalone_mode=False, obj=is_debug)
    except click.UsageError as error:
        error.show()
        sys.exit(2)
    except click.ClickException as error:
        error.show()
        sys.exit(1)
    except (click.Abort, KeyboardInterrupt):
        click.echo("scjax: interrupted; the files written so far are complete", err=True)
        sys.exit(130)
    except (ValueError, OSError) as error:
        if is_debug:
            raise
        click.echo(f"scjax: {_one_line(error)}", err=True)
        sys.exit(1)
    except Exception as error:
        if is_debug:
            raise
        click.echo(
            f"scjax: unexpected {type(error).__name__}: {_one_line(error)}. Please report it; the same command with "
            f"{DEBUG} shows the trace",
            err=True,
        )
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
