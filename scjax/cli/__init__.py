"""The command ``scjax``: scenes from prompts, and what files and models hold.

Exit codes: 0 done, 1 refused (one line on stderr says why), 2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

import click

from scjax.cli.data import data
from scjax.cli.demo import demo
from scjax.cli.evaluate import evaluate
from scjax.cli.generate import generate
from scjax.cli.inspect import caption, info, plot_command
from scjax.cli.train import train_command


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="scjax")
def cli() -> None:
    """Generates driving scenes from text.

    \b
    scjax demo                                   one picture of scenes for six prompts
    scjax generate "a T-junction with two cars"  scenes for your own prompts
    scjax info                                   domains, sizes and training of the model
    """


for command in (demo, generate, evaluate, caption, plot_command, data, train_command, info):
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point; an error that a user can cause is one line on stderr.

    Args:
      arguments: the words after the command's name; by default those of ``sys.argv``.
    """
    warnings.showwarning = lambda message, *_: click.echo(f"scjax: warning: {message}", err=True)
    try:
        code = cli.main(arguments, standalone_mode=False)
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
        click.echo(f"scjax: {error}", err=True)
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
