"""Do our readers find the same lanes as the formats' own libraries, and what do the maps look like?

python -m benchmarks.imports --env ENV --sumo SUMO --files FOLDER --out docs/results/imports

ENV is an environment with commonroad-io and Lanelet2 (`bash benchmarks/imports/install.sh ENV`), SUMO one with
netconvert (`bash benchmarks/sumo/install.sh SUMO`). FOLDER holds public files in folders named after their source;
`benchmarks/imports/sources.txt` lists them. --pictures writes a picture of every map, to be looked at.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

from benchmarks.imports.agreement import agreement, consumer_results, opendrive_agreement
from benchmarks.imports.page import page_text, picture_sheet
from benchmarks.imports.speed import crop_times
from scjax.data.imports import find_format, import_log
from scjax.data.readers import FORMATS
from scjax.scene import Log, log_to_map
from scjax.scene.files import write_text
from scjax.viz import plot_map
from scjax.viz.grid import save_figure

CONSUMERS = {"CommonRoad": "commonroad", "Lanelet2": "lanelet2"}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.imports", description=__doc__)
    parser.add_argument("--env", type=Path, help="environment with commonroad-io and Lanelet2")
    parser.add_argument("--sumo", type=Path, help="environment with netconvert")
    parser.add_argument("--files", type=Path, help="folder of public files, towns of CARLA among them")
    parser.add_argument("--page-only", action="store_true", help="write the page again from its JSON, with new remarks")
    parser.add_argument("--out", type=Path, default=Path("docs/results/imports"), help="page, without ending")
    parser.add_argument("--pictures", type=Path, help="folder for a picture of every map")
    args = parser.parse_args()
    if not args.page_only:
        if None in (args.env, args.sumo, args.files):
            parser.error("give --env, --sumo and --files")
        measure(args)
    content = json.loads(args.out.with_name(f"{args.out.name}.json").read_text(encoding="utf-8"))
    write_text(args.out.with_name(f"{args.out.name}.md"), page_text(content, args.out.name))


def measure(args: argparse.Namespace) -> None:
    """Reads all files, compares them, and writes numbers (JSON) and the sheet of pictures."""
    rows = [row for path in _files(args.files) if (row := _row(path, args.pictures)) is not None]
    for form, name in CONSUMERS.items():
        group = [row for row in rows if row["format"] == form and "log" in row]
        results = consumer_results(args.env, name, [row["path"] for row in group])
        for row in group:
            row |= agreement(row["log"], results[str(row["path"])])
    for row in rows:
        if row["format"] == "OpenDRIVE" and "log" in row:
            row |= opendrive_agreement(row["path"], args.sumo)
    sheet = picture_sheet({row["file"]: row["log"] for row in rows if "log" in row})
    content = {
        "maps": [{key: value for key, value in row.items() if key not in ("log", "path")} for row in rows],
        "crops": crop_times({row["file"]: row["log"] for row in rows if "log" in row}),
    }
    write_text(args.out.with_name(f"{args.out.name}.json"), json.dumps(content, indent=1))
    if sheet is not None:
        save_figure(sheet, args.out.with_name(f"{args.out.name}.png"), dpi=60)


def _files(folder: Path) -> list[Path]:
    paths = {path for entry in FORMATS for path in folder.rglob(entry.pattern)}
    if not paths:
        raise SystemExit(f"{folder}: no maps there: fetch those that benchmarks/imports/sources.txt lists")
    return sorted(paths, key=lambda path: (path.suffix, path.parent.name, path.name))


def _row(path: Path, pictures: Path | None) -> dict[str, Any] | None:
    """What our reader finds; None for files of none of the formats."""
    try:
        form = find_format(path)
    except ValueError:
        return None
    row: dict[str, Any] = {"file": path.name, "source": path.parent.name, "format": form, "path": path}
    start = time.process_time()
    try:
        log: Log = import_log(path)
    except ValueError as error:
        return row | {"refused": str(error).replace(f"{path}: ", "")}
    row |= {"log": log, "seconds": round(time.process_time() - start, 2), "lights": len(log.signal_lane_ids)}
    row |= {"objects": log.num_objects, "steps": log.num_steps, "num_lanes": len(log.lanes)}
    if pictures is not None:
        plot_map(
            log_to_map(log), title=f"{path.name}: {len(log.lanes)} lanes", path=pictures / f"{path.name}.png", dpi=80
        )
    return row


if __name__ == "__main__":
    main()
