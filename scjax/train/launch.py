"""Trains one network: the command behind ``scjax train`` and ``python -m experiments.train``.

    PROGRAM --config=CONFIG[:VARIANT] --workdir=FOLDER [--config.FIELD=VALUE ...]

CONFIG is autoencoder, denoiser, counts, behavior or vision (scjax/train/configs), or the path of a Python file like
these.
VARIANT is tiny, small, base or official. Train an autoencoder, then a denoiser on its model; for prompts, a denoiser
with --config.condition=text and then counts. The docstring of each config has its command, time and expected numbers.

Any field is changed on the command line: --config.batch.batch_size=32. The same command in the same FOLDER continues
at the very next batch; Ctrl-C and SIGTERM save first. At the end FOLDER/model is the model for scjax.load.

  --no-keep-memory   give freed memory back to the system (slower on CPUs; see scjax/train/malloc.py)
  --debug            print the trace of an unexpected error
  --distributed      one process of several, which JAX finds in the environment of a cluster (Slurm, Open MPI, TPUs)
  --coordinator_address=HOST:PORT --num_processes=N --process_id=I
                     the same without such a cluster, as jax.distributed.initialize takes it; HOST runs process 0

The processes need one WORKDIR that all of them see. What they train is what one process trains, apart from rounding.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from absl import flags, logging

from scjax.train.configs.renamed import check_renamed, dotted_fields
from scjax.train.malloc import without_memory_option
from scjax.train.thread_errors import collected_thread_errors

_CONFIGS = Path(__file__).parent / "configs"
_ALIASES = {"counter": "counts"}
DEBUG = "--debug"
HELP_OPTIONS = {"-h", "--help", "--helpfull"}


def main(arguments: Sequence[str], program: str) -> int:
    """Trains as the arguments say; errors that a user can cause are one line on stderr.

    Returns:
      The exit code: 0 done or stopped by a signal, 1 refused, 2 wrong usage.
    """
    arguments = without_memory_option(arguments)
    if HELP_OPTIONS & set(arguments):
        print((__doc__ or "").replace("PROGRAM", program))
        return 0
    try:
        config, workdir, distributed = parse_arguments(without_debug(arguments), program)
    except (AttributeError, KeyError, TypeError, ValueError, OSError, flags.Error) as error:
        print(f"{program}: {_one_line(error)}", file=sys.stderr)
        return 2
    import jax

    from scjax.nn.startup import start_jax

    # orbax reports every file that it touches, and logs errors with a traceback before it raises them.
    logging.set_verbosity(logging.FATAL)
    if distributed is not None:
        try:
            jax.distributed.initialize(**distributed)
        except (RuntimeError, ValueError) as error:
            advice = "give --coordinator_address, --num_processes and --process_id, the same address to all processes"
            print(f"{program}: the processes do not find each other ({_one_line(error)}): {advice}", file=sys.stderr)
            return 1
    start_jax()
    return _train(config, workdir, program, debug=DEBUG in arguments)


def _train(config: Any, workdir: Path, program: str, *, debug: bool) -> int:
    """Trains, and prints one line about what went wrong, in this thread or in another; returns the exit code.

    The process ends here if other threads may still run, fail and print.
    """
    from scjax.train.checkpoint import OrbaxError
    from scjax.train.loop import train

    with collected_thread_errors() as errors:
        failure: Exception | None = None
        try:
            train(config, workdir)
        except KeyboardInterrupt:
            print(f"{program}: interrupted before the first step; the same command starts again", file=sys.stderr)
            return 130
        except (ValueError, FloatingPointError, OSError) as error:
            failure, line = error, str(error)
            if isinstance(error, OSError) and error.filename is None:  # of a write to an open file
                line = f"{error} (in {workdir})"
        except Exception as error:
            if debug:
                raise
            failure, line = error, _unexpected_line(error)
        else:
            if not errors:
                return 0
            line = f"a thread in the background failed: {_unexpected_line(errors[0])}"
            for error in errors if debug else ():
                traceback.print_exception(error)
        print(f"{program}: {' '.join(line.split())}", file=sys.stderr, flush=True)
        if errors or isinstance(failure, OrbaxError):
            sys.stdout.flush()
            os._exit(1)
        return 1


def _unexpected_line(error: BaseException) -> str:
    advice = f"run with {DEBUG} for the trace, please report it"
    return f"unexpected {type(error).__name__}: {str(error) or 'no message'}; {advice}"


def without_debug(arguments: Sequence[str]) -> list[str]:
    """The arguments without ``--debug``."""
    return [argument for argument in arguments if argument != DEBUG]


def parse_arguments(arguments: Sequence[str], program: str) -> tuple[Any, Path, dict[str, Any] | None]:
    """(config, workdir, arguments of ``jax.distributed.initialize``; None for a process of its own).

    Raises:
      ValueError, AttributeError, KeyError, TypeError, flags.Error: a flag or field is unknown, renamed, missing or of
        another type; the message names the nearest one.
    """
    from ml_collections import config_flags

    arguments = _with_config_path(arguments)
    check_renamed(match[1] for match in map(_FIELD.match, arguments) if match)
    flags.FLAGS.mark_as_parsed()  # libraries read flags of their own
    values = flags.FlagValues()
    config_flags.DEFINE_config_file(
        "config", None, "Config and variant.", flag_values=values, lock_config=True, sys_argv=[program, *arguments]
    )
    flags.DEFINE_string("workdir", None, "Folder of the run.", flag_values=values)
    flags.DEFINE_bool("distributed", False, "One process of several.", flag_values=values)
    flags.DEFINE_string("coordinator_address", None, "HOST:PORT of process 0.", flag_values=values)
    flags.DEFINE_integer("num_processes", None, "Number of processes.", 1, flag_values=values)
    flags.DEFINE_integer("process_id", None, "Number of this process.", 0, flag_values=values)
    rest = values([program, *arguments])[1:]
    if rest:
        raise ValueError(f"unknown argument {rest[0]!r}: fields are given as --config.FIELD=VALUE")
    config, workdir = values["config"].value, values["workdir"].value
    for name, value in (("config", config), ("workdir", workdir)):
        if value is None:
            raise ValueError(f"give --{name}=..., see --help")
    check_renamed(dotted_fields(cast(Any, config).to_dict()))
    return config, Path(str(workdir)), _distributed_arguments(values)


def _distributed_arguments(values: flags.FlagValues) -> dict[str, Any] | None:
    names = "coordinator_address", "num_processes", "process_id"
    given = {name: values[name].value for name in names if values[name].value is not None}
    if given and len(given) < len(names):
        raise ValueError(f"--{' and --'.join(given)} say too little: give --{', --'.join(names)} together")
    return given if given or values["distributed"].value else None


_FIELD = re.compile(r"--?(?:no)?config\.([\w.]+)")


def _with_config_path(arguments: Sequence[str]) -> list[str]:
    """The arguments with the file of a packaged config in place of its name."""
    result = list(arguments)
    for place, argument in enumerate(result):
        if argument in ("--config", "-config") and place + 1 < len(result):
            result[place : place + 2] = [f"--config={config_path(result[place + 1])}"]
        elif match := re.match(r"--?config=(.*)", argument):
            result[place] = f"--config={config_path(match[1])}"
    return result


def config_path(config: str) -> str:
    """``NAME[:VARIANT]`` of a packaged config -> its file and variant; paths stay as they are.

    Raises:
      ValueError: neither a packaged config nor a file.
    """
    name, colon, variant = config.partition(":")
    packaged = _CONFIGS / f"{_ALIASES.get(name, name)}.py"
    if packaged.is_file() and "/" not in name:
        return f"{packaged}{colon}{variant}"
    if not Path(name).is_file():
        names = sorted(
            path.stem for path in _CONFIGS.glob("*.py") if path.stem not in ("__init__", "renamed", "schema")
        )
        raise ValueError(f"--config={config}: no such file, and no config of that name: choose {', '.join(names)}")
    return config


def _one_line(error: Exception) -> str:
    """The message of an error without line breaks; of a config file's error its last line, without the traceback."""
    text = str(error.args[0] if error.args else error).strip()
    if "Traceback (most recent call last)" in text:
        text = text.splitlines()[-1].partition(": ")[2]
    return " ".join(text.split()) or type(error).__name__
