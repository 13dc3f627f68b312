"""The command ``scjax``: scenes from prompts, and a look at files.

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
from scjax.cli.inspect import caption, info, plot
from scjax.cli.train import train


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="scjax")
def cli() -> None:
    """Driving scenes from a line of text.

    \b
    scjax demo                                   a picture of scenes for several prompts
    scjax generate "a T-junction with two cars"  scenes of your own
    scjax info                                   the model that is used, and what it knows
    """


for command in (demo, generate, evaluate, caption, plot, data, train, info):
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point: errors that a user can cause are one line on stderr. ``arguments``: by default ``sys.argv``."""
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
        click.echo("scjax: interrupted: files that are there are whole", err=True)
        sys.exit(130)
    except (ValueError, OSError) as error:
        click.echo(f"scjax: {error}", err=True)
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
