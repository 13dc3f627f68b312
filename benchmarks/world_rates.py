"""How often does every attribute value occur in scenes, and which pairs of common values never meet?

    python -m scjax data synthetic RECORDS --worlds 250 --seed 5
    python -m scjax data scenes RECORDS --out SCENES -n 2000 --format npz
    python -m benchmarks.world_rates SCENES            # a folder of .npz files, one scene each
    python -m benchmarks.world_rates SCENES --least 1  # values below 1 % of the scenes only

A range counts by number: 0, 1, 2, ... up to 7, and 8 or more.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from scjax.language.attributes.table import ATTRIBUTES, measure_attributes
from scjax.scene.io import load_npz

MOST = 8
COMMON = 0.1  # share of scenes from which on a value is common
LEFT_OUT = ("not_layout", "compare", "where")  # they follow from the others


def values_of(name: str, measured: Any) -> list[str]:
    """The values of a measurement, as rows of the table."""
    if measured is None:
        return ["nothing"]
    if ATTRIBUTES[name].kind == "flag":
        return ["yes" if measured else "no"]
    if ATTRIBUTES[name].kind == "range":
        if ATTRIBUTES[name].unit:
            return [f"{10 * int(measured // 10)} {ATTRIBUTES[name].unit} and more"]
        return [f"{MOST} or more" if measured >= MOST else str(int(measured))]
    return list(measured) or ["nothing"]


def expected_values(name: str) -> list[str]:
    """The values that a set of scenes should show."""
    attribute = ATTRIBUTES[name]
    return list(attribute.values) if attribute.kind in ("choice", "set") else []


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.world_rates", description=__doc__)
    parser.add_argument("scenes", type=Path, help="folder of .npz files")
    parser.add_argument("--least", type=float, default=100.0, help="show values up to this share of the scenes [%%]")
    args = parser.parse_args(arguments)
    files = sorted(args.scenes.glob("*.npz"))
    if not files:
        sys.exit(f"{args.scenes} has no .npz files: write some with `scjax data scenes`")
    names = [name for name in ATTRIBUTES if name not in LEFT_OUT]
    rows: dict[tuple[str, str], set[int]] = {(name, value): set() for name in names for value in expected_values(name)}
    for number, file in enumerate(tqdm(files, "scenes")):
        measured = measure_attributes(load_npz(file))
        for name in names:
            for value in values_of(name, measured[name]):
                rows.setdefault((name, value), set()).add(number)
    print(f"| attribute | value | % of {len(files)} scenes |\n| --- | --- | --- |")
    for name in names:
        for key in sorted(key for key in rows if key[0] == name):
            share = 100 * len(rows[key]) / len(files)
            if share <= args.least:
                print(f"| {name} | {key[1]} | {share:.1f} |")
    shown = {key: found for key, found in rows.items() if key[1] not in ("no", "nothing")}
    common = [key for key, found in shown.items() if len(found) >= COMMON * len(files)]
    pairs = [(a, b) for a, b in itertools.combinations(common, 2) if a[0] != b[0]]
    apart = [(a, b) for a, b in pairs if not rows[a] & rows[b]]
    met = np.array([len(rows[a] & rows[b]) for a, b in pairs])
    print(f"\n{len(common)} values are common (at least {COMMON:.0%}); of their {len(pairs)} pairs ", end="")
    print(f"{len(apart)} never occur, {int((met < 3).sum())} less than three times.")
    for a, b in apart:
        print(f"- {a[0]} {a[1]} with {b[0]} {b[1]}")


if __name__ == "__main__":
    main()
