"""The official release and scjax by turns on one machine: python -m benchmarks.peer --release FOLDER --python PYTHON

FOLDER is a checkout of the release (github.com/princeton-computational-imaging/ScenarioControl), PYTHON an interpreter
with torch, torch-geometric and tqdm. Both sides work on the same scenes with random weights and given features. In a
turn each side has a process of its own, one after the other; the faster one of two passes counts.

Prints seconds a scene (the median over the turns, with all turns), the ratio, useful work as a share of the rate of a
large matrix product, peak memory, and how long the first turn compiled. Rows are named by what is done:
train-autoencoder, sample-text-8 (100 guided steps in batches of 8).
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks import workload
from benchmarks.sampler import useful_flops
from benchmarks.steps import CONTEXT, KINDS, autoencoder_config, denoiser_config
from scjax.models import flops

ROWS = (
    *(f"train-{kind}" for kind in KINDS),
    *(f"sample-{kind}-8" for kind in KINDS[1:]),
    *(f"sample-{kind}-1" for kind in KINDS[1:]),
)
_STEPS = 100
_PASSES = 2


class Worker:
    """One side's process; ``ask`` sends a line and returns the answer."""

    def __init__(self, command: list[str], job: dict[str, Any], environment: dict[str, str]):
        self.command = [*command, json.dumps(job)]
        self.process = subprocess.Popen(
            self.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self.ready = self._answer()

    def ask(self, line: str) -> dict[str, Any]:
        """The answer to "go" or "end".

        Raises:
          RuntimeError: the process ended; with the last lines that it wrote.
        """
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None and self.process.stderr is not None
        for line in self.process.stdout:
            if line.startswith("{"):
                return json.loads(line)
        last = "\n".join(self.process.stderr.read().strip().splitlines()[-5:])
        raise RuntimeError(f"{' '.join(self.command[:2])} ended without an answer:\n{last}")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peer", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", default=[], metavar="ROW", help=f"default: all of {', '.join(ROWS)}")
    parser.add_argument("--release", required=True, type=Path, metavar="FOLDER", help="checkout of the release")
    parser.add_argument("--python", required=True, type=Path, metavar="PYTHON", help="interpreter with torch")
    parser.add_argument("--size", choices=["small", "official"], default="small", help="widths of the networks")
    parser.add_argument("--compute", choices=["float32", "bfloat16"], nargs="+", default=["float32", "bfloat16"])
    parser.add_argument("--turns", type=int, default=3, help="processes of each side (default: 3)")
    parser.add_argument("--scenes", type=int, help="scenes of a pass (default: 64 to train, 16 or 4 to sample)")
    parser.add_argument("--release-steps", type=int, default=10, help="steps that the release samples, of its 100")
    parser.add_argument("--out", type=Path, help="JSON Lines file to which rows are added")
    args = parser.parse_args(arguments)
    if unknown := set(args.rows) - set(ROWS):
        parser.error(f"unknown rows {', '.join(sorted(unknown))}: choose from {', '.join(ROWS)}")
    if not (args.release / "nn_modules" / "ldm.py").is_file():
        parser.error(f"--release {args.release} has no nn_modules/ldm.py: give a checkout of the release")
    if not args.python.is_file():
        parser.error(f"--python {args.python} is no file: give the interpreter that has torch")
    todo = [(row, compute) for compute in args.compute for row in args.rows or ROWS]
    rows = []
    for name, compute in tqdm(todo, "rows", unit="row", disable=None):
        try:
            rows.append(side_by_side(job_of(name, compute, args), args))
        except RuntimeError as error:
            parser.exit(1, f"{name}, {compute}: {error}\n")
        if args.out:
            with args.out.open("a") as file:
                file.write(json.dumps({**rows[-1], "machine": workload.machine()}) + "\n")
    print(workload.table(rows))


def job_of(name: str, compute: str, args: argparse.Namespace) -> dict[str, Any]:
    """The work of a row, as both workers read it."""
    work, kind, *size = name.split("-")
    batch = int(size[0]) if size else 16
    scenes = args.scenes or (64 if work == "train" else 16 if batch > 1 else 4)
    parts = workload.batch_counts(batch, scenes if work == "train" else 64)
    parts = parts if work == "train" else workload.evenly(parts, max(scenes // batch, 1))
    return {
        "name": name,
        "work": work,
        "kind": kind,
        "batch": batch,
        "compute": compute,
        "size": args.size,
        "threads": len(os.sched_getaffinity(0)),
        "release_steps": args.release_steps,
        "parts": parts,
        "sizes": release_sizes(kind, args.size),
    }


def release_sizes(kind: str, size: str) -> dict[str, int]:
    """The release's names for the sizes of our network."""
    if kind == "autoencoder":
        config = autoencoder_config("float32", size)
        return {
            "hidden_dim": config.lane_width,
            "num_heads": config.lane_heads,
            "dim_f": config.lane_ff,
            "agent_hidden_dim": config.agent_width,
            "agent_num_heads": config.agent_heads,
            "agent_dim_f": config.agent_ff,
            "lane_conn_hidden_dim": config.edge_width,
            "num_encoder_blocks": config.encoder_blocks,
            "num_decoder_blocks": config.decoder_blocks,
            "lane_latent_dim": config.lane_latent,
            "agent_latent_dim": config.agent_latent,
        }
    config = denoiser_config(kind, "float32", size)
    return {
        "hidden_dim": config.lane_width,
        "num_heads": config.lane_heads,
        "agent_hidden_dim": config.agent_width,
        "agent_num_heads": config.agent_heads,
        "num_factorized_dit_blocks": config.blocks,
        "num_l2l_blocks": config.l2l_stages,
        "lane_latent_dim": config.lane_latent,
        "agent_latent_dim": config.agent_latent,
    }


def side_by_side(job: dict[str, Any], args: argparse.Namespace) -> dict[str, Any]:
    """One row: both sides by turns. While one side works, no process of the other is there: it would take memory."""
    commands = {
        "release": [str(args.python), str(Path(__file__).with_name("release.py")), str(args.release)],
        "scjax": [sys.executable, "-m", "benchmarks.peer.ours", "-"],
    }
    seconds: dict[str, list[float]] = {side: [] for side in commands}
    answers: dict[str, list[dict[str, Any]]] = {side: [] for side in commands}
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache}  # compiled in the first turn
        for _ in range(args.turns):
            for side, command in commands.items():
                worker = Worker(command, job, environment)
                seconds[side].append(min(worker.ask("go")["seconds"] for _ in range(_PASSES)))
                answers[side].append({**worker.ready, **worker.ask("end")})
                worker.process.wait()
    scenes = sum(map(len, job["parts"]))
    medians = {side: statistics.median(times) / scenes for side, times in seconds.items()}
    rate = useful_work(job) / scenes / medians["scjax"] / 1e9
    return {
        "row": job["name"],
        "compute": job["compute"],
        "size": job["size"],
        "release s/scene": medians["release"],
        "scjax s/scene": medians["scjax"],
        "ratio": medians["release"] / medians["scjax"],
        "turns (release; scjax)": "; ".join(
            ", ".join(f"{time / scenes:.3g}" for time in times) for times in seconds.values()
        ),
        "useful GFLOP/s": rate,
        "share of the product": rate / max(answer["roofline"] for answer in answers["scjax"]),
        "release GB": max(answer["peak_gb"] for answer in answers["release"]),
        "scjax GB": max(answer["peak_gb"] for answer in answers["scjax"]),
        "compile s": answers["scjax"][0]["compile_s"],
    }


def useful_work(job: dict[str, Any]) -> float:
    """Closed-form FLOPs of scjax's networks on the real lanes and agents of a pass."""
    kind, compute, size = job["kind"], job["compute"], job["size"]
    scenes = [scene for part in job["parts"] for scene in part]
    if kind == "autoencoder":
        config = autoencoder_config(compute, size)
        return sum(3 * flops.autoencoder_forward(config, *scene) for scene in scenes)
    config = denoiser_config(kind, compute, size)
    if job["work"] == "train":
        return sum(3 * flops.denoiser_forward(config, *scene, CONTEXT[kind]) for scene in scenes)
    return sum(useful_flops(config, kind, _STEPS, part) for part in workload.padded(job["parts"]))


if __name__ == "__main__":
    main()
