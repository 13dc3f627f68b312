"""What do the ten conditioning mechanisms cost? python -m benchmarks.attention --out=benchmarks/results

Microbenchmark on one core (attention-variants §10). For every mechanism it times the core alone (queries, keys and
values as inputs), the module (encode, then attend) and a step with a cached condition, forward and backward, over the
numbers of keys and queries and at the sizes of real scenes. It compares closed-form FLOPs with XLA's count. The log-log
slope of the core over the keys shows which mechanisms grow with the context.

OUT receives attention.jsonl (one line per point; existing points are not measured again), attention.md (tables) and
attention.png. --smoke measures three small points per mechanism, checks FLOPs and slopes, and writes nothing.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tqdm import tqdm

from benchmarks.attention_points import DENSE, VARIANTS, Point
from benchmarks.workload import table
from scjax.scene.files import write_text
from scjax.viz.grid import save_figure

KEYS = (64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384)
QUERIES = (16, 32, 64, 128, 256)
REAL = ((161, 392, True), (161, 512, False))  # scene tokens, context tokens, image
WIDTHS = {256: 8, 512: 8, 2048: 16}  # and their heads
LONG = (512, 4096, 16384)
NO_CORE = ("full, 2x parameters",)  # its projections change the width
SLOPES = {name: 1.0 for name in VARIANTS} | {"windowed": 0.0, "deformable": 0.0, "linear": 0.0, "agent, learned": 0.0}
_POINTS_PER_PROCESS = 8  # points of a process


def points(part: str) -> list[Point]:
    """The points of a part of the benchmark: keys, queries, real or long."""
    names = [name for name in VARIANTS if name not in NO_CORE]
    if part == "keys":
        return [Point(name, "core", back, 160, m) for m in KEYS for name in names for back in (False, True)]
    if part == "queries":
        return [Point(name, "core", back, n, 392) for n in QUERIES for name in names for back in (False, True)]
    stages = [(stage, back) for stage in ("module", "cached") for back in (False, True)]
    if part == "long":
        return [Point(name, stage, back, 160, m) for m in LONG for name in VARIANTS for stage, back in stages]
    return [
        Point(name, stage, back, n, m, d, heads, image=image)
        for n, m, image in REAL
        for d, heads in WIDTHS.items()
        for name in VARIANTS
        for stage, back in stages
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.attention", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--out", type=Path, default=Path("benchmarks/results"), help="folder (default: %(default)s)")
    add("--parts", nargs="+", default=["keys", "queries", "real", "long"], help="of the benchmark (default: all)")
    add("--cores", type=int, default=1, help="cores to run on (default: 1)")
    add("--smoke", action="store_true", help="three small points per mechanism; checks FLOPs, writes nothing")
    args = parser.parse_args(arguments)
    if args.smoke:
        smoke()
        return
    args.out.mkdir(parents=True, exist_ok=True)
    log = args.out / "attention.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    done = {point_of(row) for row in rows}
    pending = [point for part in args.parts for point in points(part) if point not in done]
    for row in tqdm(measure_points(pending, args.cores), "points", total=len(pending), disable=None):
        rows.append(row)
        with log.open("a") as file:
            file.write(json.dumps(row) + "\n")
    write_text(args.out / "attention.md", report(rows))
    plot_scaling(rows, args.out / "attention.png")
    print(report(rows))


def measure_points(pending: Sequence[Point], cores: int) -> Iterator[dict[str, Any]]:
    """Rows of the points, some of them a process at a time, on so many cores."""
    flags = f"--xla_cpu_multi_thread_eigen={'true' if cores > 1 else 'false'} intra_op_parallelism_threads={cores}"
    allowed = sorted(os.sched_getaffinity(0))[:cores]
    for start in range(0, len(pending), _POINTS_PER_PROCESS):
        part = [dataclasses.asdict(point) for point in pending[start : start + _POINTS_PER_PROCESS]]
        child = subprocess.run(
            [sys.executable, "-m", "benchmarks.attention_points"],
            input=json.dumps(part),
            text=True,
            check=True,
            stdout=subprocess.PIPE,
            env={**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
            preexec_fn=lambda: os.sched_setaffinity(0, allowed),
        )
        yield from (json.loads(line) for line in child.stdout.splitlines())


def smoke() -> None:
    """Three contexts: XLA counts what the closed form counts, and as many FLOPs more with longer contexts."""
    lengths = (256, 512, 1024)
    rows = list(measure_points([Point(name, "core", False, 32, m, 64, 4) for m in lengths for name in DENSE], 1))
    faults = []
    for name in DENSE:
        own = [row for row in rows if row["variant"] == name]
        ratio = [row["flops_xla"] / row["flops_closed"] for row in own]
        slope = log_slope(lengths, [row["flops_xla"] for row in own])
        print(f"{name:<18} XLA's FLOPs / closed form {min(ratio):.3f}..{max(ratio):.3f}, slope over keys {slope:.2f}")
        if not all(0.95 < r < 1.35 for r in ratio) or abs(slope - 1) > 0.25:
            faults.append(name)
    if faults:
        sys.exit(
            f"benchmarks.attention: counts of {', '.join(faults)} are off: see ``work`` of the mechanism's "
            f"options in scjax/nn/cross_attention"
        )


def log_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope of log y over log x by least squares."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def point_of(row: dict[str, Any]) -> Point:
    """The point that a row belongs to."""
    return Point(**{field.name: row[field.name] for field in dataclasses.fields(Point)})


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: slopes of the core, then whole modules at real sizes and over long contexts."""
    lines = ["# Conditioning mechanisms, timed", "", "`python -m benchmarks.attention --out=benchmarks/results`", ""]
    lines += ["## Core over the number of keys (160 queries, width 256, 8 heads)", ""]
    table_rows = []
    for name in VARIANTS:
        own = {row["m"]: row for row in rows if _is(row, name, "core", False, n=160) and row["m"] in KEYS}
        tail = [m for m in sorted(own) if m >= 1024]
        if len(tail) >= 2:
            slope = log_slope(tail, [own[m]["median_s"] for m in tail])
            times = {f"m = {m}": f"{1e3 * own[m]['median_s']:.2f} ms" if m in own else "" for m in (512, 4096, 16384)}
            table_rows.append(
                {"mechanism": name, **times, "slope from 1,024 on": f"{slope:.2f}", "expected": SLOPES[name]}
            )
    lines += [table(table_rows) if table_rows else "not measured", ""]
    sizes = [(n, m, d, image) for n, m, image in REAL for d in WIDTHS] + [(160, m, 256, False) for m in LONG]
    for n, m, d, image in sizes:
        table_rows = []
        for name in VARIANTS:
            cells: dict[str, Any] = {"mechanism": name}
            for stage in ("module", "cached"):
                for back in (False, True):
                    row = next((r for r in rows if _is(r, name, stage, back, n=n, m=m, d=d, image=image)), None)
                    title = f"{stage} {'forward + backward' if back else 'forward'} ms"
                    cells[title] = "" if row is None else f"{1e3 * row['median_s']:.2f}"
                    if row is not None and not back:
                        cells[f"{stage} MFLOP"] = f"{row['flops_closed'] / 1e6:.0f}"
                        cells[f"{stage} share of peak"] = f"{100 * row['share']:.0f} %"
            if len(cells) > 5:
                table_rows.append(cells)
        if table_rows:
            lines += [
                f"## {n} queries, {m} keys ({'image' if image else 'text'}), width {d}",
                "",
                table(table_rows),
                "",
            ]
    unsteady = sum(not row["steady"] for row in rows)
    if rows:
        machine = {name: rows[-1][name] for name in ("cpu", "jax", "amx")}
        lines += [f"{len(rows)} points; during {unsteady} of them the roofline moved by more than 5 %. {machine}"]
    return "\n".join(lines) + "\n"


def plot_scaling(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Time of the core over keys and over queries, forward, on logarithmic axes."""
    figure = Figure(figsize=(14, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    for ax, title, key, fixed, ticks in (
        (axes[0], "keys (160 queries)", "m", {"n": 160}, KEYS),
        (axes[1], "queries (392 keys)", "n", {"m": 392}, QUERIES),
    ):
        series = defaultdict(list)
        for row in rows:
            if row["stage"] == "core" and not row["backward"] and all(row[k] == v for k, v in fixed.items()):
                series[row["variant"]].append((row[key], 1e3 * row["median_s"]))
        for number, name in enumerate(VARIANTS):
            if name in series:
                x, y = zip(*sorted(series[name]), strict=True)
                style = "--" if "dense-masked" in name else "-"
                ax.plot(
                    x,
                    y,
                    style,
                    marker="osv^Dx*"[number % 7],
                    markersize=4,
                    linewidth=1.3,
                    label=name,
                    color=colormaps["tab20"](number),
                )
        ax.set(xscale="log", yscale="log", xlabel=title, ylabel="ms, core, forward, one core")
        ax.set_xticks(ticks, [f"{tick:,}" for tick in ticks], rotation=45)
        ax.minorticks_off()
        ax.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
    save_figure(figure, path, dpi=80)


def _is(row: dict[str, Any], variant: str, stage: str, backward: bool, **fields: Any) -> bool:
    expected = {"variant": variant, "stage": stage, "backward": backward, **fields}
    return all(math.isclose(row[k], v) if isinstance(v, float) else row[k] == v for k, v in expected.items())


if __name__ == "__main__":
    main()
