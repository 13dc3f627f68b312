"""Finds SUMO and runs its programs. It is an optional extra (``traffic``), used when data are made."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from scjax.scene.wheels import installed_module

VARIABLE = "SUMO_HOME"
SUMO_VERSION = "1.28.0"
_CURE = f"pip install 'scjax[traffic]', or set {VARIABLE} to a folder of SUMO {SUMO_VERSION}"


@dataclasses.dataclass(frozen=True)
class Sumo:
    """An installation of SUMO.

    Attributes:
      home: its folder, with bin and data.
    """

    home: Path

    def run(self, program: str, arguments: Sequence[str | Path], folder: Path) -> str:
        """Runs a program of SUMO in ``folder``; returns what it says on stderr.

        Raises:
          ValueError: it fails; its last line.
        """
        command = [str(self.home / "bin" / program), *map(str, arguments)]
        environment = os.environ | {VARIABLE: str(self.home)}
        result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if result.returncode:
            lines = result.stderr.splitlines()
            errors = [line for line in lines if line.startswith("Error")] or [*lines, "it gives no reason"]
            raise ValueError(f"{program} of SUMO fails: {errors[0][:200].strip()}")
        return result.stderr


def find_sumo() -> Sumo:
    """SUMO in $SUMO_HOME, in the installed package eclipse-sumo, or beside ``sumo`` on the path.

    Raises:
      ValueError: there is none; says how to get it.
    """
    places = [os.environ.get(VARIABLE)]
    places.append(str(installed_module("sumo") or ""))
    program = shutil.which("sumo")
    if program is not None:
        places.append(str(Path(program).resolve().parents[1]))
    for place in places:
        if place and all((Path(place) / "bin" / name).is_file() for name in ("netconvert", "sumo")):
            return Sumo(Path(place))
    raise ValueError(f"SUMO, which makes the traffic, is not here: {_CURE}")
