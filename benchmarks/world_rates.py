"""How often does every attribute value occur in scenes, and which pairs of common values never meet, and why?

    python -m scjax data synthetic RECORDS --worlds 8000 --seed 401
    python -m scjax data attributes RECORDS
    python -m benchmarks.world_rates RECORDS --least 3  # measured training records; values below 3 % only
    python -m benchmarks.world_rates SCENES             # or a folder of .npz files, one scene each

A range counts by number: 0, 1, 2, ... up to 7, and 8 or more. A pair that never occurs contradicts itself by the
definitions of docs/attributes.md, or is missing.
"""

from __future__ import annotations

import argparse
import collections
import itertools
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scjax.data.measurements import MeasuredRecords, measurements_path
from scjax.language.attributes.table import ATTRIBUTES, measure_attributes
from scjax.scene.io import load_npz

MOST = 8
COMMON = 10.0  # % of the scenes from which on a value is common
FEW = 10  # scenes; pairs that occur in fewer are listed too
LEFT_OUT = ("not_layout", "compare", "where")  # they follow from the others
Value = tuple[str, str]
"""Name of an attribute, and one of its values as a row of the table."""

PART_OF = {  # count -> counts that are no smaller
    "ahead": ("vehicles",),
    "behind": ("vehicles",),
    "left_lane": ("vehicles",),
    "right_lane": ("vehicles",),
    "oncoming": ("vehicles",),
    "crossing": ("vehicles",),
    "large": ("vehicles",),
    "stopped": ("vehicles",),
    "parked": ("vehicles", "stopped"),
    "pedestrians_on_road": ("pedestrians",),
    "pedestrians_ahead": ("pedestrians",),
    "gap_ahead": ("vehicles", "ahead"),
    "queue": ("vehicles",),
}
AT_A_JUNCTION = ("ego_arm", "turn_lane")
WITHOUT_JUNCTION = (("layout", "straight"), ("layout", "no-intersection"))
QUEUE_SIZE = 3


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


def contradiction(first: Value, second: Value) -> str | None:
    """Why no scene can have both values, by the definitions of the attributes; None if one can."""
    pair = dict((first, second))
    if pair.keys() & set(AT_A_JUNCTION) and {first, second} & set(WITHOUT_JUNCTION):
        return "one needs a junction, the other has none"
    for (part, number), (whole, other) in ((first, second), (second, first)):
        if whole in PART_OF.get(part, ()) and _least(part, number) > _bounds(other)[1]:
            return "one counts a part of the other"
    if not any(_fits(pair, *lanes) for lanes in _roads()):
        return "the numbers of lanes exclude each other"
    return None


def _bounds(value: str) -> tuple[float, float]:
    """Least and greatest number of a count's value."""
    least = int(value.split()[0])
    return least, math.inf if value.endswith("more") else least


def _least(name: str, value: str) -> float:
    """How many there are at least, by a count or by what needs some."""
    if name == "gap_ahead":
        return 1
    if name == "queue":
        return QUEUE_SIZE if value == "yes" else 0
    return _bounds(value)[0]


def _roads() -> Iterator[tuple[int, int, int]]:
    """Lanes with the ego's direction and against it, and the number of the ego's lane."""
    for same, opposite in itertools.product(range(1, MOST + 1), range(MOST + 1)):
        yield from ((same, opposite, index) for index in range(1, same + 1))


def _fits(pair: dict[str, str], same: int, opposite: int, index: int) -> bool:
    """Whether a road can have these values."""
    numbers = {"lanes_same": same, "lanes_opposite": opposite, "lanes_total": same + opposite, "ego_lane_index": index}
    for name, value in pair.items():
        if name in numbers:
            least, most = _bounds(value)
            fits = least <= numbers[name] <= most
        elif name in ("one_way", "median"):
            fits = (opposite == 0) == (value == "yes") if name == "one_way" else opposite > 0 or value == "no"
        elif name == "ego_lane":
            fits = same > 1 and value == ("leftmost" if index == 1 else "rightmost" if index == same else "middle")
        else:
            fits = name != "oncoming" or value == "0" or opposite > 0
        if not fits:
            return False
    return True


def read_measurements(folder: Path) -> Iterator[dict[str, Any]]:
    """What the scenes of a folder show: of measured training records, or of .npz files."""
    if measurements_path(folder, "train").is_file():
        records = MeasuredRecords(folder, "train")
        yield from (records[row] for row in range(len(records)))
        return
    files = sorted(folder.glob("*.npz"))
    if not files or (folder / "manifest.json").is_file():
        sys.exit(
            f"{folder} has neither attributes-train.jsonl.gz nor scenes: run `scjax data attributes` on records, or "
            "write scenes with `scjax data scenes --format npz`"
        )
    yield from (measure_attributes(load_npz(file)) for file in files)


def count_values(folder: Path) -> tuple[list[Value], np.ndarray]:
    """All values in the order of the attributes, and in which scenes each occurs [scenes, values]."""
    names = [name for name in ATTRIBUTES if name not in LEFT_OUT]
    shown: dict[Value, list[int]] = {(name, value): [] for name in names for value in expected_values(name)}
    number = 0
    for number, measured in enumerate(read_measurements(folder), 1):
        for name in names:
            for value in values_of(name, measured[name]):
                shown.setdefault((name, value), []).append(number - 1)
    values = sorted(shown, key=lambda value: (names.index(value[0]), value[1]))
    table = np.zeros((number, len(values)), bool)
    for column, value in enumerate(values):
        table[shown[value], column] = True
    return values, table


def print_pairs(values: list[Value], table: np.ndarray, common: float) -> None:
    """How many pairs of common values occur, which do not, and why."""
    shares = 100 * table.mean(0)
    columns = [k for k, value in enumerate(values) if value[1] not in ("no", "nothing") and shares[k] >= common]
    chosen = table[:, columns].astype(np.float32)
    together = (chosen.T @ chosen).astype(int)
    names = [values[k] for k in columns]
    pairs = [(i, j) for i, j in itertools.combinations(range(len(names)), 2) if names[i][0] != names[j][0]]
    never = [(names[i], names[j]) for i, j in pairs if not together[i, j]]
    reasons = collections.Counter(contradiction(*pair) or "missing" for pair in never)
    wrong = [(names[i], names[j]) for i, j in pairs if together[i, j] and contradiction(names[i], names[j])]
    print(f"\n{len(names)} values are common (at least {common:g} %); of their {len(pairs)} pairs ", end="")
    print(f"{len(pairs) - len(never)} occur. The other {len(never)}:\n\n| why | pairs |\n| --- | --- |")
    for reason in sorted(reasons, key=lambda reason: (reason == "missing", -reasons[reason])):
        members = [pair for pair in never if (contradiction(*pair) or "missing") == reason]
        print(f"| {reason} ({reasons[reason]}) | {'; '.join(f'{_text(a)} with {_text(b)}' for a, b in members)} |")
    few = [(names[i], names[j], int(together[i, j])) for i, j in pairs if 0 < together[i, j] < FEW]
    rare = [f"{_text(a)} with {_text(b)} ({count})" for a, b, count in few]
    print(f"\nPairs in fewer than {FEW} scenes: {'; '.join(rare) or 'none'}.")
    print(f"Pairs that occur although the definitions exclude them: {wrong or 'none'}.")


def _text(value: Value) -> str:
    return f"{value[0]} {value[1]}"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.world_rates",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="records with measured attributes, or scenes as .npz files")
    parser.add_argument("--least", type=float, default=100.0, help="show values up to this share of the scenes [%%]")
    parser.add_argument("--common", type=float, default=COMMON, help="share from which a value is common [%%]")
    args = parser.parse_args(arguments)
    values, table = count_values(args.folder)
    print(f"| attribute | value | % of {len(table)} scenes |\n| --- | --- | --- |")
    for value, share in zip(values, 100 * table.mean(0), strict=True):
        if share <= args.least:
            print(f"| {value[0]} | {value[1]} | {share:.1f} |")
    print_pairs(values, table, args.common)


if __name__ == "__main__":
    main()
