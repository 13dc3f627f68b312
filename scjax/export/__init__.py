"""Logs in files that other programs open. One file a format; a new one is one more line in ``EXPORTS``."""

from __future__ import annotations

from pathlib import Path

from scjax.export.base import Export, ExportReport, Losses
from scjax.export.commonroad import COMMONROAD_EXPORT
from scjax.export.gpudrive import GPUDRIVE_EXPORT
from scjax.export.opendrive import OPENDRIVE_EXPORT
from scjax.export.openscenario import OPENSCENARIO_EXPORT
from scjax.export.own_files import NPZ_EXPORT, RECORDING_EXPORT
from scjax.export.roadgen_formats import CLIPGT_EXPORT, LANELET2_EXPORT, RDSHQ_EXPORT, SUMO_EXPORT, WOMD_EXPORT
from scjax.export.scenarionet import SCENARIONET_EXPORT
from scjax.export.waymax import WAYMAX_EXPORT
from scjax.scene import Log, validate_log

EXPORTS: dict[str, Export] = {
    "npz": NPZ_EXPORT,
    "json": RECORDING_EXPORT,
    "scenarionet": SCENARIONET_EXPORT,
    "waymax": WAYMAX_EXPORT,
    "gpudrive": GPUDRIVE_EXPORT,
    "commonroad": COMMONROAD_EXPORT,
    "opendrive": OPENDRIVE_EXPORT,
    "openscenario": OPENSCENARIO_EXPORT,
    "lanelet2": LANELET2_EXPORT,
    "sumo": SUMO_EXPORT,
    "womd": WOMD_EXPORT,
    "clipgt": CLIPGT_EXPORT,
    "rdshq": RDSHQ_EXPORT,
}
"""Name of a format -> its export."""


def export_log(log: Log, path: str | Path, format: str) -> ExportReport:
    """Writes ``log`` in the format of another program.

    A map is a log too: ``scjax.scene.map_to_log``.

    Args:
      path: file to write, or folder for formats of several files.
      format: a name in ``scjax.export.EXPORTS``.

    Returns:
      The files, and what the format cannot say about this log.

    Raises:
      ValueError: the format is unknown, the log is invalid, or it cannot be said in this format.
      OSError: the files cannot be written; none is half written.
    """
    if format not in EXPORTS:
        raise ValueError(f"format is {format!r}: choose from {', '.join(EXPORTS)}")
    losses = Losses()
    paths = EXPORTS[format].write(validate_log(log), Path(path), losses)
    return ExportReport(paths, dict(sorted((+losses).items())))


__all__ = ["EXPORTS", "Export", "ExportReport", "Losses", "export_log"]
