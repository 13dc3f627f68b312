"""Imports OpenDRIVE files with netconvert and writes them again with roadgen: one JSON line for each file.

python consumers/checks/sumo_import.py FILE.xodr ...
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

AS_WRITTEN = (
    "--opendrive.import-all-lanes",  # also those that are not for cars
    "--junctions.endpoint-shape",  # the file says where junctions end
)
"""Options of netconvert with which it takes files as they are."""
THRESHOLDS = (
    *("--geometry.min-radius", "3"),  # [m]; some lanes are bent more than 9
    *("--junctions.limit-turn-speed.warn.straight", "10"),  # [m/s]; a file without speed limits gets 50 km/h
)
"""Options of netconvert that move thresholds of its warnings."""
_PROGRAM = re.compile("Guessing signalID|cycle time of")
"""About programs of traffic lights that netconvert makes up, since OpenDRIVE holds none."""


def main(files: list[str]) -> None:
    for file in files:
        print("RESULT " + json.dumps({"file": file, **import_net(file)}), flush=True)
        print("RESULT " + json.dumps({"file": file, **write_again(file)}), flush=True)


def import_net(file: str) -> dict:
    """Warnings of netconvert, by their words; with its own thresholds, and with ours."""
    _, plain, _ = _converted(file, *AS_WRITTEN)
    status, lines, text = _converted(file, *AS_WRITTEN, *THRESHOLDS)
    programs = [line for line in lines if _PROGRAM.search(line)]
    lines = [line for line in lines if not _PROGRAM.search(line)]
    return {
        "consumer": "netconvert",
        "ok": status == 0 and not lines and bool(text),
        "warnings": _kinds(lines),
        "warnings_by_default": _kinds([line for line in plain if not _PROGRAM.search(line)]),
        "signal_program_notes": _kinds(programs),
        "example": lines[:3],
        "edges": len(re.findall(r"<edge (?![^>]*function=)", text)),
        "signal_programs": text.count("<tlLogic "),
    }


def _converted(file: str, *options: str) -> tuple[int, list[str], str]:
    """Exit status, warnings, and the network."""
    with tempfile.TemporaryDirectory() as folder:
        program, net = Path(sys.executable).with_name("netconvert"), Path(folder, "net.xml")
        command = [str(program), *options, "--opendrive-files", file, "--output-file", str(net)]
        process = subprocess.run(command, capture_output=True, text=True)
        text = net.read_text() if net.is_file() else ""
    lines = [line for line in process.stderr.splitlines() if line.startswith(("Warning", "Error"))]
    return process.returncode, lines, text


def _kinds(lines: list[str]) -> dict[str, int]:
    """Warnings without names and numbers -> how often."""
    plain = (re.sub(r"'[^']*'", "'...'", re.sub(r"-?\d[\d.]*", "N", line)) for line in lines)
    return dict(Counter(plain))


def write_again(file: str) -> dict:
    """What roadgen says about a file, and which formats it writes of it."""
    import roadgen

    formats = {
        "opendrive": "again.xodr",
        "lanelet2": "map.osm",
        "sumo": "sumo",
        "gpudrive": "scene.json",
        "womd": "map.tfrecord",
        "clipgt": "clipgt",
        "rdshq": "rdshq",
    }
    row: dict = {"consumer": "roadgen", "ok": False, "formats": [], "error": "", "notes": []}
    with tempfile.TemporaryDirectory() as folder:
        try:
            town = roadgen.read_opendrive(file)
            row["notes"] = [str(note)[:200] for note in town.read_warnings()][:5]
            for name, target in formats.items():
                getattr(town, f"export_{name}")(f"{folder}/{target}")
                row["formats"].append(name)
            row["ok"] = True
        except Exception as error:  # a judge's errors are results
            row["error"] = f"{type(error).__name__}: {error}"[:400]
    return row


if __name__ == "__main__":
    main(sys.argv[1:])
