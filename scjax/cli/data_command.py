"""What the commands of ``scjax data`` share: errors of one line, interruptions, repeated options."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click


class DataError(click.ClickException):
    """An error that the user can mend, as one line on stderr; exit code 1."""

    def show(self, file: Any = None) -> None:
        click.echo(f"error: {self.message}", err=True)


class DataCommand(click.Command):
    """A command whose errors are one line, and which says what an interruption left behind."""

    def __init__(self, *args: Any, interrupted: str, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.interrupted = interrupted

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Accepts several values after a repeatable option: ``--events A B`` is ``--events A --events B``."""
        repeatable = {name for option in self.params if getattr(option, "multiple", False) for name in option.opts}
        return super().parse_args(ctx, _repeat_options(args, repeatable))

    def invoke(self, ctx: click.Context) -> Any:
        for param in self.params:
            if ctx.params.get(param.name or "") == "":
                raise click.UsageError(f"{param.human_readable_name} is empty: give the name of a folder", ctx)
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            raise DataError(f"{error}: install the data extra, pip install 'scjax[data]'") from error
        except (ValueError, OSError) as error:
            raise DataError(str(error)) from error
        except KeyboardInterrupt:
            click.echo(f"interrupted: {self.interrupted}", err=True)
            ctx.exit(130)


def _repeat_options(args: Sequence[str], repeatable: set[str]) -> list[str]:
    repeated, option = [], None
    for arg in args:
        if arg.startswith("-"):
            option = arg if arg in repeatable else None
        elif option and repeated[-1] != option:
            repeated.append(option)
        repeated.append(arg)
    return repeated


workers_option = click.option(
    "--workers",
    type=int,
    default=2,
    metavar="N",
    show_default=True,
    help="Worker processes; 0 works in this process.",
)
