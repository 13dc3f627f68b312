"""Scalars of a run for TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


class TensorBoardWriter:
    """Writes scalars into one new event file of a folder, which is made if it is missing.

    It writes in the calling thread: what fails, as on a full disk, is raised there. The writer of tensorboardX has a
    thread for that. When it dies, the training waits forever for room in its queue.

    Args:
      first_step: step that the run continues after; TensorBoard hides what older files have of later ones.

    Raises:
      OSError: by every method, if the file cannot be written.
    """

    def __init__(self, folder: Path, first_step: int):
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2

        folder.mkdir(parents=True, exist_ok=True)
        self._messages: Any = event_pb2  # its classes exist at run time only
        self._events = EventsWriter(str(folder / "events"))
        restart = self._messages.SessionLog(status=self._messages.SessionLog.START)
        self._events.write_event(self._messages.Event(session_log=restart, step=first_step + 1))

    def scalars(self, step: int, time: float, values: Mapping[str, float]) -> None:
        """Writes values by their names, at a time [s since 1970], to the disk."""
        event = self._messages.Event(step=step, wall_time=time)
        for name, value in values.items():
            event.summary.value.add(tag=name, simple_value=value)
        self._events.write_event(event)
        self._events.flush()

    def close(self) -> None:
        """Closes the file."""
        self._events.close()
