"""Formats that the package roadgen makes of our OpenDRIVE file: Lanelet2, SUMO, Waymo's map format, ClipGT, RDS-HQ."""

from __future__ import annotations

import importlib
import importlib.util
import tempfile
from collections.abc import Callable
from pathlib import Path

from scjax.export.base import Export, Losses
from scjax.export.opendrive import write_opendrive
from scjax.scene import Log
from scjax.scene.files import whole_folder, write_file

ROADGEN_VERSION = "0.41.2"
"""Version that the formats were checked with."""


def _writer(method: str, suffix: str) -> Callable[[Log, Path, Losses], tuple[Path, ...]]:
    """An export by the method ``export_<method>`` of a map of roadgen."""

    def write(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
        if importlib.util.find_spec("roadgen") is None:
            raise ValueError(
                f"this format is made by roadgen, which is not installed: pip install roadgen=={ROADGEN_VERSION}, or "
                "pip install 'scjax[formats]'"
            )
        roadgen = importlib.import_module("roadgen")
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder, "map.xodr")
            write_opendrive(log, source, losses)
            try:
                town = roadgen.read_opendrive(str(source))
                if not suffix:
                    with whole_folder(path, "the export") as part:
                        getattr(town, f"export_{method}")(str(part), trace=False)
                    return tuple(sorted(item for item in path.rglob("*") if item.is_file()))
                target = Path(folder, f"target{suffix}")
                getattr(town, f"export_{method}")(str(target), trace=False)
            except ValueError as error:
                text = " ".join(str(error).split())[:300]
                raise ValueError(f"roadgen refuses the map: {text}: export it as opendrive instead") from error
            content = target.read_bytes()
            write_file(path, lambda file: file.write(content))
        return (path,)

    return write


LANELET2_EXPORT = Export("Lanelet2", ".osm", "Autoware, Lanelet2", _writer("lanelet2", ".osm"))
SUMO_EXPORT = Export("SUMO", "", "SUMO's netconvert", _writer("sumo", ""))
WOMD_EXPORT = Export("Waymo Open Motion map", ".tfrecord", "Waymo's tools", _writer("womd", ".tfrecord"))
CLIPGT_EXPORT = Export("ClipGT", "", "NVIDIA's tools", _writer("clipgt", ""))
RDSHQ_EXPORT = Export("RDS-HQ", "", "Cosmos-Transfer", _writer("rdshq", ""))
