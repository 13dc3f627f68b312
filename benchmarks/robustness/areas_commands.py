"""Command lines with odd values, each in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import names
from benchmarks.robustness.case import Case, Refused
from benchmarks.robustness.fixtures import PROMPT
from benchmarks.robustness.invariants import scene_fault

_SCJAX = "import sys; from scjax.cli import main; sys.argv[0] = 'scjax'; main()"
_ODD = (
    "-1",
    "0",
    "1.5",
    "nan",
    "inf",
    "1e30",
    "-1e30",
    "9223372036854775808",
    "99999999999999999999",
    "",
    "word",
    "0x10",
    "１２",
    "\udcff",
    "-",
    "--",
    "3,4",
    "None",
    "x" * 300,
    "/dev/null",
    "/proc/1/x",
    "a\nb",
    ".",
    "../..",
)
_OLD_FLAGS = {"--num-steps": "--steps", "--best-of": "--pick", "--energy-guidance": "--steer"}
_SECONDS = 150.0  # on the clock; the machine may be busy


def commands(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """``scjax`` and its commands: every option with odd values."""
    old = names.is_old()
    pairs = [(words, flag, value) for words, flags in _templates(fixtures, old) for flag in flags for value in _ODD]
    for k in rng.permutation(len(pairs))[:140]:
        words, flag, value = pairs[k]
        flag = _OLD_FLAGS.get(flag, flag) if old else flag
        if flag == "PLACE":
            arguments = [value if word == "PLACE" else word for word in words]
        else:
            arguments = [word for word in words if word != "PLACE"] + [f"{flag}={value}"]
        yield _case(fixtures, arguments, flag, value)
    for words, _ in _templates(fixtures, old):
        if "PLACE" not in words:
            yield _case(fixtures, words, "", "")  # undamaged
    for arguments in _fixed(fixtures, old):
        flag = arguments[-1].removeprefix("--config.").partition("=")[0].rpartition(".")[2] if arguments else ""
        yield _case(fixtures, arguments, flag, "")


def _templates(fixtures: Path, old: bool) -> list[tuple[list[str], list[str]]]:
    """Words of a command, and the options that get odd values; PLACE is the positional argument that gets them."""
    steps = ["--steps", "2", "--pick", "1", "--tries", "1"] if old else ["--num-steps", "2", "--best-of", "1"]
    model, scene = str(fixtures / "text"), str(fixtures / "scene.npz")
    generate = [
        "generate",
        PROMPT,
        "--agents",
        "2",
        "--lanes",
        "3",
        "--model",
        model,
        "--format",
        "npz",
        "--out",
        "out",
        *steps,
    ]
    options = [
        "-n",
        "--seed",
        "--best-of",
        "--num-steps",
        "--guidance",
        "--sampler",
        "--temperature",
        "--agents",
        "--lanes",
        "--negative",
        "--domain",
        "--out",
        "--format",
        "--model",
    ]
    build = ["data", "build", str(fixtures / "recordings"), "out", "--workers", "0"]
    scenes = ["data", "scenes", "records", "--out", "out", "-n", "2"]
    new = [(scenes, ["-n", "--format", "--split", "--seed"]), (["data", "scenes", "PLACE", "--out", "out"], ["PLACE"])]
    return [
        *([] if old else new),
        (generate, options),
        (["generate", "PLACE", *generate[2:]], ["PLACE"]),
        *([] if old else [(["generate", "--prompts", "PLACE", "--out", "out"], ["PLACE"])]),
        (["caption", scene], ["--style", "--seed"]),
        (["caption", "PLACE"], ["PLACE"]),
        (["plot", scene], ["--out"]),
        (["plot", "PLACE"], ["PLACE"]),
        (["info"], ["--model"]),
        (["demo", "--out", "out", *steps], ["--seed", "--out", "--model"]),
        (
            build,
            ["--split-percent", "--limit", "--files-per-shard", "--spacing", "--max-poses", "--train-other-stride"],
        ),
        (["data", "build", "PLACE", "out"], ["PLACE"]),
        (
            ["data", "synthetic", "out", "--worlds", "1", "--workers", "0"],
            ["--seed", "--ordinary", "--events", "--worlds"],
        ),
        (["data", "caption", "records", "--workers", "0"], ["--texts", "--seed"]),
        (["data", "caption", "PLACE"], ["PLACE"]),
        (["data", "embed", "PLACE", "--encoder", str(fixtures / "bert")], ["PLACE"]),
        (["data", "embed", "records", "--encoder", str(fixtures / "bert")], ["--encoder", "--split"]),
    ]


def _fixed(fixtures: Path, old: bool) -> list[list[str]]:
    """Command lines of which no option is odd, but all of it."""
    lines = [[], ["word"], ["--word"], ["generate"], ["plot"], ["data"], ["data", "word"], ["info", "extra", "words"]]
    if not old:
        train = ["train", "--config=autoencoder:tiny", "--workdir=run", f"--config.records={fixtures / 'records'}"]
        odd = [
            "steps=word",
            "batch.batch_size=0",
            "optimiser=3",
            "optimizer.kind=sgd",
            "batch.buckets=3",
            "model.lane_width=-1",
            "word=3",
            "seed=1.5",
            "records=/nowhere",
            "init_from=/nowhere",
            "sharding=word",
            "codec=word",
        ]
        lines += [["train", "--word"], ["train", "--config=word"], ["train", "--config=autoencoder:word"], train[:2]]
        lines += [[*train, f"--config.{one}"] for one in odd]
    return lines


def _case(fixtures: Path, arguments: list[str], flag: str, value: str) -> Case:
    shown = [word for word in (value, ascii(value)[1:-1]) if len(word) > 1 or (word and flag == "PLACE")]
    shown += [" ".join(value.split())] if "\n" in value else []  # messages are one line
    shown += [value[:2]] if flag == "PLACE" and value.startswith("-") else []  # read as an option of one letter
    words = [Path(word).name for word in arguments if "/" in word and "\n" not in word and len(Path(word).name) > 1]
    words += [part for word in arguments for part in word.partition("=")[2].split(":") if len(part) > 2]
    if flag == "PLACE" and not value:
        shown += [".", "is empty"]  # an empty path is the current folder, or is called empty
    named = (flag.strip("-"), flag.strip("-").replace("-", "_"), *shown, *words)
    if value == "" or flag == "PLACE":
        named += ("prompt", "workdir", "config", "records")  # what is missing may be named
    text = " ".join(ascii(word) if len(word) < 60 else f"...{word[-30:]!a}" for word in arguments)

    def write(folder: Path) -> None:
        (folder / "command.txt").write_text(ascii(arguments))
        if "records" in arguments:  # this command writes into them
            shutil.copytree(fixtures / "records", folder / "records")

    return Case(
        f"scjax ... {text[-85:]}",
        lambda folder: _run(folder, arguments),
        lambda end: _fault(end, flag, value),
        tuple(filter(None, named)) or ("command", "option"),
        write,
    )


def _run(folder: Path, arguments: list[str]) -> Any:
    command = [sys.executable, "-c", _SCJAX, *arguments]
    if any("\0" in word for word in arguments):
        raise ValueError("a null byte cannot be given to a process")
    end = subprocess.run(
        command,
        cwd=folder,
        env=dict(os.environ),
        capture_output=True,
        timeout=_SECONDS,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    output, errors = (text.decode("utf-8", "replace") for text in (end.stdout, end.stderr))
    if end.returncode or "Traceback (most recent call last)" in errors:
        return Refused(errors[-4000:] + ("" if errors else output[-4000:]), end.returncode)
    return folder, output, errors


def _fault(end: Any, flag: str, value: str) -> str | None:
    folder, output, errors = end
    for path in folder.rglob("*.npz"):
        if (
            path.parent.name != "records"
            and "index" not in path.name
            and (fault := scene_fault(names.get("load_npz")(path)))
        ):
            return f"{path.name}: {fault}"
    if not output.strip() and not errors.strip():
        return "exit status 0 without a word"
    if flag in ("--guidance", "--temperature") and abs(float(value)) > 1e6:
        return f"{flag} {value} is accepted"
    return None
