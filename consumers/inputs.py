"""Makes the inputs of the page of results: python -m consumers.inputs [--number N] [--prompts FILE] [--out DIR]

- generated: one scene, repaired, for every fifth prompt of ``--prompts``, simulated for ``--seconds``.
- worlds: logs of synthetic worlds of every kind.
- recordings: files spread evenly over those of each data set in the shared data (``SCJAX_DATA_DIR``).

A line of ``--prompts`` is a prompt, or JSON with "prompt" and "id". Files that are there stay as they are.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
from pathlib import Path

import numpy as np
from tqdm import tqdm

NUMBER, SECONDS = 50, 10.0
_SHARED = Path(os.environ.get("SCJAX_SHARED", "../shared"))
PROMPTS = _SHARED / "prompts" / "dev.jsonl"
_EVERY = 5  # prompts, of which one is used
_WORLDS = 26
_WORLD_SEED, _SAMPLE_SEED = 7, 0
_RECORDINGS = {"womd": 13, "nuscenes_mini": 5, "av2": 4, "commonroad": 2}
_SUFFIXES = (".json.gz", ".xml")


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m consumers.inputs", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--number", type=int, default=NUMBER, help="generated logs (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each (default: %(default)s)")
    parser.add_argument("--prompts", type=Path, default=PROMPTS, metavar="FILE", help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("runs/exports/inputs"), help="(default: %(default)s)")
    args = parser.parse_args()
    for path in make_inputs(args.out, args.prompts, number=args.number, seconds=args.seconds):
        print(path)


def make_inputs(folder: Path, prompts: Path = PROMPTS, *, number: int = NUMBER, seconds: float = SECONDS) -> list[Path]:
    """Writes the inputs that are not there yet; returns all of them.

    Raises:
      ValueError: there are not enough prompts.
    """
    generated = _generated(folder / "generated", read_prompts(prompts, number), seconds)
    return [*generated, *_worlds(folder / "worlds"), *_recordings(folder / "recordings")]


def read_prompts(path: Path, number: int) -> dict[str, str]:
    """Every fifth prompt of a file: id -> prompt.

    Raises:
      ValueError: the file is not there, or too short.
    """
    if not path.is_file():
        raise ValueError(f"{path} is not there: name a file of prompts with --prompts")
    lines = path.read_text(encoding="utf-8").splitlines()[::_EVERY][:number]
    if len(lines) < number:
        raise ValueError(f"{path} has {len(lines)} prompts, every fifth line counted: {number} are needed")
    rows = [json.loads(line) if line.startswith("{") else {"prompt": line} for line in lines]
    return {str(row.get("id", f"line-{_EVERY * index + 1}")): row["prompt"] for index, row in enumerate(rows)}


def _worlds(folder: Path) -> list[Path]:
    from scjax.scene import save_log
    from scjax.synthetic.recording import to_log
    from scjax.synthetic.world import make_world

    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"world-{_WORLD_SEED}-{k}.npz" for k in range(_WORLDS)]
    for k, path in enumerate(tqdm(paths, "worlds", disable=None)):
        if not path.is_file():
            save_log(to_log(make_world(_WORLD_SEED, k)), path)
    return paths


def _recordings(folder: Path) -> list[Path]:
    """Copies of recordings; none where the shared data are absent."""
    folder.mkdir(parents=True, exist_ok=True)
    data = Path(os.environ.get("SCJAX_DATA_DIR") or _SHARED / "data")
    paths = []
    for name, number in _RECORDINGS.items():
        files = sorted(path for path in (data / name).glob("*") if path.name.endswith(_SUFFIXES))
        for row in np.linspace(0, len(files) - 1, min(number, len(files))).astype(int):
            paths.append(folder / files[row].name)
            shutil.copyfile(files[row], paths[-1])
    return paths


def _generated(folder: Path, prompts: dict[str, str], seconds: float) -> list[Path]:
    import jax

    import scjax
    from scjax.nn.startup import start_jax
    from scjax.scene import save_log

    start_jax()
    folder.mkdir(parents=True, exist_ok=True)
    paths = {name: folder / f"{name}.npz" for name in prompts}
    key = jax.random.key(_SAMPLE_SEED)
    if not all(path.is_file() for path in paths.values()):
        scenes = [
            scjax.sample(jax.random.fold_in(key, row), prompt, repair=True)[0].to_numpy()
            for row, prompt in enumerate(tqdm(prompts.values(), "scenes", disable=None))
        ]
        logs = scjax.simulate(key, scenes, seconds=seconds)
        for path, log in zip(paths.values(), logs, strict=True):
            if not path.is_file():
                save_log(log, path)
    return list(paths.values())


if __name__ == "__main__":
    main()
