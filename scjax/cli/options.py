"""Options that several commands share, and old names of options."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from scjax.cli.output import say
from scjax.data.ranges import MAX_SEED

DEFAULT_BEST_OF = 4
"""Candidates for each scene: as many as one call of a compiled program samples."""

RENAMED = {
    "--steps": "--num-steps",
    "--pick": "--best-of",
    "--raw": "--no-repair",
    "--steer": "--energy-guidance",
    "--no-steer": "--no-energy-guidance",
}
"""Old flag -> new flag of the same meaning. The old ones work until the next version."""

REMOVED = {
    "--tries": "candidates are no longer sampled in several rounds: ask for more of them at once with --best-of",
}
"""Old flag -> what replaced it."""


class GenerationCommand(click.Command):
    """A command that still reads the old names of its options, with a warning."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Replaces old flags before click reads them; UsageError for flags that are gone."""
        end = args.index("--") if "--" in args else len(args)
        return super().parse_args(ctx, [_current_flag(word) for word in args[:end]] + args[end:])


def _current_flag(word: str) -> str:
    flag, equals, value = word.partition("=")
    if flag in REMOVED:
        raise click.UsageError(f"{flag}: {REMOVED[flag]}")
    if flag not in RENAMED:
        return word
    say(f"scjax: warning: {flag} is now {RENAMED[flag]}; the old name stops working with the next version")
    return RENAMED[flag] + equals + value


class LateHelp(click.Option):
    """An option whose help names defaults of modules that take a second to import: ``late_help`` is called to print
    it."""

    def __init__(self, *args: Any, late_help: Callable[[], str], **kwargs: Any):
        super().__init__(*args, **kwargs)
        self._late_help = late_help

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """The option and its help."""
        self.help = self._late_help()
        return super().get_help_record(ctx)


def _steps_help() -> str:
    from scjax.diffusion.samplers import DEFAULT_STEPS

    defaults = ", ".join(
        f"{name} {steps}" for name, steps in (DEFAULT_STEPS["flow"] | DEFAULT_STEPS["velocity"]).items()
    )
    return f"Sampling steps; fewer are faster. [default: the model's, else {defaults}]"


num_steps_option = click.option("--num-steps", type=click.IntRange(2, 100), cls=LateHelp, late_help=_steps_help)
seed_option = click.option(
    "--seed",
    default=0,
    show_default=True,
    type=click.IntRange(0, MAX_SEED),
    metavar="N",
    help="Random seed: the same seed gives the same results, on the same kind and number of processors.",
)
best_of_option = click.option(
    "--best-of",
    default=DEFAULT_BEST_OF,
    show_default=True,
    type=click.IntRange(1, 100),
    metavar="N",
    help="Candidates for each scene. The one that shows most of the prompt is kept; of equals, the one with the fewest "
    "faults (overlaps, open lane connections, vehicles off the road).",
)
repair_option = click.option(
    "--repair/--no-repair",
    default=True,
    show_default=True,
    help="Smooth lanes, close lane connections and separate overlapping boxes after sampling.",
)
out_option = click.option(
    "--out", "folder", default=".", show_default=True, metavar="DIR", help="Folder for the files; created if missing."
)
model_option = click.option(
    "--model", "model_folder", metavar="DIR", help="Model folder. [default: the model that ships with scjax]"
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the results as JSON on stdout.")
