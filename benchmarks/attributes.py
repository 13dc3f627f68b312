"""Do our attributes agree with the independent judge of people's prompts, scene by scene and key by key?

The judge runs as a program of its own on the same scene files; nothing of it is imported.

    python -m scjax data synthetic RECORDS --worlds 60 --seed 5
    python -m scjax data scenes RECORDS --out SCENES -n 400 --format npz
    python -m benchmarks.attributes SCENES            # a folder of .npz files, one scene each
    python -m benchmarks.attributes tiles -n 300      # tiles of real scenes, from SCJAX_SHARED
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from scjax.evaluate.eval_tiles import EvaluationTiles
from scjax.language.attributes.table import measure_attributes
from scjax.scene.io import load_npz, save_npz

SHARED = Path(os.environ.get("SCJAX_SHARED", "../shared"))
COUNTS = (
    *("lanes_same", "lanes_opposite", "lanes_total", "vehicles", "pedestrians", "cyclists", "static", "large"),
    *("ahead", "behind", "left_lane", "right_lane", "oncoming", "crossing", "parked", "stopped"),
    *("pedestrians_on_road", "pedestrians_ahead"),
)
GAP_TOLERANCE = 1.0  # m
MIN_QUEUE = 3
SLOPE = 0.6  # m


def _first(measured: tuple[str, ...]) -> str:
    return measured[0] if measured else "none"


def _speed_name(speed: float) -> str:
    return "stopped" if speed < 0.5 else "fast" if speed > 12 else "slow" if speed <= 4 else "moving"


def _slope_name(rise: float | None) -> str | None:
    return None if rise is None else "up" if rise > SLOPE else "down" if rise < -SLOPE else "flat"


def _signal(judged: dict[str, Any]) -> str:
    """The judge says "none" also of an ego that sees no light; our attribute then says "any"."""
    return "any" if judged["signal"] == "none" and judged["signals"] else judged["signal"]


def pairs(ours: dict[str, Any], judged: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Key -> (our measurement, the judge's), in one form."""
    both = {name: (ours[name], judged[name]) for name in (*COUNTS, "one_way", "median")}
    both |= {name: (sorted(ours[name]), sorted(judged[name])) for name in ("turn_lane", "event")}
    both["bend"] = _first(ours["bend"]), judged["bend"] or "none"
    both["ego_arm"] = _first(ours["ego_arm"]), judged["ego_arm"] or "none"
    both["slope"] = _first(ours["slope"]), _slope_name(judged["slope"]) or "none"
    both["signal"] = _first(ours["signal"]), _signal(judged)
    both["ego"] = _first(ours["ego"]), _speed_name(judged["ego"])
    both["queue"] = ours["queue"], judged["queue"] >= MIN_QUEUE
    both["layout"] = _layouts(ours["layout"], judged)
    both["gap_ahead"] = _gaps(ours["gap_ahead"], judged["gap_ahead"])
    return both


def _layouts(names: tuple[str, ...], judged: dict[str, Any]) -> tuple[str, str]:
    """First words; equal if each side's first word may pass on the other side."""
    first, may = judged["layout"], set(judged["layout_may"]) | {judged["layout"]}
    agrees = names[0] in may and (first in names or first not in ALL_LAYOUTS)
    return (first, first) if agrees else (names[0], first)


def _gaps(gap: float | None, judged: float | None) -> tuple[Any, Any]:
    if gap is None or judged is None:
        return gap if gap is None else round(gap), judged if judged is None else round(judged)
    return (0, 0) if abs(gap - judged) < GAP_TOLERANCE else (round(gap), round(judged))


ALL_LAYOUTS = frozenset(
    (
        *("straight", "curve", "winding", "four-way", "T", "Y", "roundabout", "merge", "split", "dead-end"),
        *("parking-lot", "intersection", "no-intersection", "multi-intersection", "crossing-overpass"),
    )
)


def judge(folder: Path) -> dict[str, dict[str, Any]]:
    """File name -> what the judge measured."""
    command = [sys.executable, str(SHARED / "prompts" / "judge.py"), "--describe", str(folder)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    return {row["scene"]: row for row in map(json.loads, lines)}


def compare(folder: Path, judged: dict[str, dict[str, Any]], report: Callable[[str], None], examples: int) -> float:
    """Prints agreement by key with the kinds of disagreement; returns the share of agreeing pairs."""
    kinds: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
    places: dict[tuple[str, str], list[str]] = collections.defaultdict(list)
    total: collections.Counter = collections.Counter()
    seconds = []
    for name, row in judged.items():
        scene = load_npz(folder / f"{name}.npz")
        start = time.process_time()
        ours = measure_attributes(scene)
        seconds.append(time.process_time() - start)
        for key, (own, other) in pairs(ours, row).items():
            total[key] += 1
            if own != other:
                kind = f"{own} / {other}"
                kinds[key][kind] += 1
                places[key, kind].append(name)
    differing = sum(sum(counter.values()) for counter in kinds.values())
    report(f"| key | agrees % of {len(judged)} | ours / judge, most frequent first |\n| --- | --- | --- |")
    for key in sorted(total, key=lambda key: -sum(kinds[key].values())):
        shown = ", ".join(f"{kind} ({n})" for kind, n in kinds[key].most_common(6))
        report(f"| {key} | {100 * (1 - sum(kinds[key].values()) / total[key]):.1f} | {shown} |")
        for kind, _ in kinds[key].most_common(6)[: 6 if examples else 0]:
            report(f"      {kind}: {', '.join(places[key, kind][:examples])}")
    share = 1 - differing / max(sum(total.values()), 1)
    report(f"| all | {100 * share:.2f} | {differing} of {sum(total.values())} pairs differ |")
    report(f"\nms per scene: median {1e3 * np.median(seconds):.1f}, 95 % {1e3 * np.quantile(seconds, 0.95):.1f}")
    return share


def write_tiles(folder: Path, count: int) -> None:
    """Real tiles, evenly drawn, as scene files."""
    tiles = EvaluationTiles(str(SHARED / "eval" / "tiles_real_train.npz"), "all")
    rows = np.linspace(0, len(tiles.clusters) - 1, count).astype(int)
    for row, scene in zip(rows, tiles.read(rows.tolist()), strict=True):
        agents = np.array(scene.agents)
        agents[:, 6:9] = agents[:, 6:9].clip(0.1)  # some recordings hold boxes without a width
        save_npz(scene.replace(agents=agents), folder / f"tile-{row:05d}.npz")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", help="folder of .npz files, or tiles")
    parser.add_argument("-n", type=int, default=300, help="number of tiles")
    parser.add_argument("--judged", help="what the judge printed for these scenes before, as .jsonl")
    parser.add_argument("--examples", type=int, default=0, help="names of scenes to print for each kind")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(arguments.scenes)
        if arguments.scenes == "tiles":
            folder = Path(temporary)
            write_tiles(folder, arguments.n)
        if arguments.judged:
            rows = map(json.loads, Path(arguments.judged).read_text(encoding="utf-8").splitlines())
            judged = {row["scene"]: row for row in rows}
        else:
            judged = judge(folder)
        compare(folder, judged, print, arguments.examples)


if __name__ == "__main__":
    main()
