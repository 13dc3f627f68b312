"""Runs the rules of the ASAM quality checker on OpenDRIVE and OpenSCENARIO files: one JSON line for each file.

python consumers/checks/asam_rules.py FILE ...
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

_CONFIG = """<Config>
 <Param name="InputFile" value="{file}"/>
 <CheckerBundle application="{bundle}">
  <Param name="resultFile" value="{result}"/>
 </CheckerBundle>
</Config>
"""
_PROGRAMS = {".xodr": ("qc_opendrive", "xodrBundle"), ".xosc": ("qc_openscenario", "xoscBundle")}


def main(files: list[str]) -> None:
    for file in files:
        print("RESULT " + json.dumps(check(Path(file))), flush=True)


def check(file: Path) -> dict:
    """Completed and skipped rules, and issues."""
    program, bundle = _PROGRAMS[file.suffix]
    with tempfile.TemporaryDirectory() as folder:
        config, result = Path(folder, "config.xml"), Path(folder, "result.xqar")
        config.write_text(_CONFIG.format(file=file.resolve(), bundle=bundle, result=result))
        command = [str(Path(sys.executable).with_name(program)), "-c", str(config)]
        process = subprocess.run(command, capture_output=True, text=True, cwd=folder)
        row = {"file": str(file), "consumer": program, "ok": False}
        if not result.is_file():
            return {**row, "error": process.stderr[-400:]}
        root = ElementTree.parse(result).getroot()
    checkers = list(root.iter("Checker"))
    states = {checker.get("checkerId", "").removeprefix("check_asam_"): checker.get("status") for checker in checkers}
    issues = [
        f"{checker.get('checkerId', '').removeprefix('check_asam_')}: {issue.get('description', '')[:160]}"
        for checker in checkers
        for issue in checker.iter("Issue")
    ]
    completed = sorted(name for name, state in states.items() if state == "completed")
    schema = [name for name in completed if "valid_schema" in name]
    return {
        **row,
        "ok": not issues and bool(schema) and "error" not in states.values(),
        "completed": len(completed),
        "skipped": sorted(name for name, state in states.items() if state == "skipped"),
        "failed": sorted(name for name, state in states.items() if state == "error"),
        "issues": len(issues),
        "example": issues[:5],
    }


if __name__ == "__main__":
    main(sys.argv[1:])
