"""The page of the results: tables, what was seen in the pictures, and a sheet of some of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.imports.agreement import ALLOWED, agrees
from benchmarks.imports.seen import SEEN, SHEET
from scjax.scene import Log, log_to_map
from scjax.viz import plot_map

COMMAND = """bash benchmarks/imports/install.sh runs/consumers
bash benchmarks/sumo/install.sh runs/sumo
python -m benchmarks.imports --env runs/consumers --sumo runs/sumo --files FOLDER --out docs/results/imports"""
DIFFERENCES = """Why some differ, as far as was looked at:

- Lanelet2: four connections of mapping_example lead into lanelets for both directions, against their stored direction.
  We read such lanelets in one direction. Four maps have `local_x` and `local_y` alone, which the library cannot read.
- Lengths of Lanelet2 differ where a lanelet is short and wide: both programs have their own middle line.
- ARG_Carcarana-1_1, BEL_Wervik-2_1, DEU_Guetersloh-11_2 and ZAM_Threewayintersection were written by a converter. Their
  links join lanes that drive towards each other. We count and refuse these; netconvert takes them, with shorter roads.
- In FourWaySignal, roundabout, highway_intersection_test0, lane_offset_intersection, lane_width_and_offset and
  parking_demo, lanes of netconvert are shorter near junctions and sections, or one is missing.
- straight_road: the road is 2,000 m long and its curve 500 m; we go straight on.
- ZAM_CurvedLanelet: the center of 15 m trembles.
- Of maps with left-hand traffic no connection is in both. That was not looked into.

The comparison and the pictures found three faults of our readers, which are mended: directions of short and wide
lanelets of Lanelet2, lights of CommonRoad whose direction fits no way, and OpenDRIVE borders on the right that are
written as distances. The rows of Lanelet2 and poly3_and_border_record were measured again after that, by the same
command."""
TIMES = ("median_seconds", "most_seconds")
INTRODUCTION = """# Files of others, read

Do our readers find the lanes that the formats' own libraries find? Compared are the number of lanes and their total
length, on public files that are not in this repository (`benchmarks/imports/sources.txt` lists them). Values are ours /
theirs. Of OpenDRIVE only lanes for cars outside of junctions are compared. "Seen" is what was noticed in a picture of
the map. All were looked at. Where nothing is said, nothing was noticed in a small picture."""
LIBRARIES = {"CommonRoad": "commonroad-io 2024.3", "Lanelet2": "Lanelet2 1.2.3", "OpenDRIVE": "netconvert 1.28.0"}


def page_text(content: Mapping[str, Any], name: str) -> str:
    """The page as markdown."""
    rows = content["maps"]
    text = [INTRODUCTION, f"```bash\n{COMMAND}\n```", _summary(rows)]
    for form, library in LIBRARIES.items():
        text += [f"## {form} beside {library}", _compared([row for row in rows if row["format"] == form])]
    others = [row for row in rows if row["format"] not in LIBRARIES and "refused" not in row]
    text += [
        DIFFERENCES,
        "## Without a second opinion",
        "No library of these formats was installed beside ours.",
        _table(
            ("file", "format", "lanes", "objects", "steps", "lights", "seen"),
            [
                (_short(row), *(row[key] for key in ("format", "num_lanes", "objects", "steps", "lights")), _seen(row))
                for row in others
            ],
        ),
        "## Scenes cut from large maps",
        "CPU seconds of `crop_map`, at nine places of each map.",
        _table(
            ("map", "lanes", "points", "extent [m]", "median [s]", "most [s]"),
            [
                (
                    row["map"],
                    row["lanes"],
                    row["points"],
                    "{} x {}".format(*row["extent"]),
                    *(row[key] for key in TIMES),
                )
                for row in content["crops"]
            ],
        ),
        "## Refused",
        "\n".join(f"- {_short(row)}: {row['refused']}" for row in rows if "refused" in row),
        f"![maps]({name}.png)",
    ]
    return "\n\n".join(text) + "\n"


def picture_sheet(logs: Mapping[str, Log]) -> Figure | None:
    """Some of the maps side by side; None if none of them is there."""
    names = [name for name in SHEET if name in logs]
    if not names:
        return None
    columns = 4
    figure = Figure(figsize=(columns * 4.0, -(-len(names) // columns) * 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    for number, name in enumerate(names):
        axes = figure.add_subplot(-(-len(names) // columns), columns, number + 1)
        plot_map(log_to_map(logs[name]), ax=axes, title=name, legend=False)
        axes.set(xlabel="", ylabel="")
    return figure


def _summary(rows: list[dict[str, Any]]) -> str:
    lines = []
    for form in dict.fromkeys(row["format"] for row in rows):
        group = [row for row in rows if row["format"] == form]
        compared = [row for row in group if "their_lanes" in row]
        fails, refused = (sum(key in row for row in group) for key in ("their_error", "refused"))
        lines.append((form, len(group), len(compared), sum(map(agrees, compared)), fails, refused))
    return _table(("format", "files", "compared", f"within {ALLOWED:g} %", "library fails", "we refuse"), lines)


def _compared(rows: list[dict[str, Any]]) -> str:
    lines: list[tuple[Any, ...]] = []
    for row in rows:
        if "refused" in row:
            continue
        if "their_error" in row:
            seen = f"library: {row['their_error']}. {_seen(row)}"
            lines.append((_short(row), f"{row['lanes']} / -", f"{row['length']:.0f} / -", "", "", row["lights"], seen))
            continue
        share = 100 * (row["length"] / row["their_length"] - 1) if row["their_length"] else 0.0
        lines.append(
            (
                _short(row),
                f"{row['lanes']} / {row['their_lanes']}",
                f"{row['length']:.0f} / {row['their_length']:.0f}",
                f"{share:+.2f} %{'' if agrees(row) else f' **over {ALLOWED:g} %**'}",
                f"{row['connections']} / {row['their_connections']} / {row['both_connections']}",
                row["lights"],
                _seen(row),
            )
        )
    head = ("file", "lanes", "length [m]", "difference", "connections, ours / theirs / in both", "lights", "seen")
    return _table(head, lines)


def _table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def _edges(extent: list[int]) -> str:
    return f"{extent[0]} x {extent[1]}"


def _seen(row: dict[str, Any]) -> str:
    return SEEN.get(row["file"], "")


def _short(row: dict[str, Any]) -> str:
    name = row["file"].removeprefix("log_map_archive_")
    return name if len(name) <= 44 else f"{name[:40]}..."
