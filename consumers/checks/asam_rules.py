"""Runs the rules of the ASAM quality checker on OpenDRIVE and OpenSCENARIO files: one JSON line for each file.

python consumers/checks/asam_rules.py FILE ...
"""

from __future__ import annotations

import importlib
import json
import logging
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
    row = {"file": str(file), "consumer": program, "ok": False}
    with tempfile.TemporaryDirectory() as folder:
        config, result = Path(folder, "config.xml"), Path(folder, "result.xqar")
        config.write_text(_CONFIG.format(file=file.resolve(), bundle=bundle, result=result))
        try:
            _run(program, config)
            root = ElementTree.parse(result).getroot()
        except Exception as error:  # a judge's errors are results
            return {**row, "error": f"{type(error).__name__}: {error}"[:400]}
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


def _run(program: str, config: Path) -> None:
    """The checker's own entry point, in this process: starting it takes longer than its rules."""
    module = importlib.import_module(f"{program}.main")
    logging.disable(logging.INFO)
    arguments, sys.argv = sys.argv, [program, "-c", str(config)]
    try:
        module.main()
    finally:
        sys.argv = arguments


if __name__ == "__main__":
    main(sys.argv[1:])
