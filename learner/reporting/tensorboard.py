"""TensorBoard scalars in the run directory, beside metrics.jsonl: tensorboard --logdir RUN_DIR shows them.

Events are written at once by the library's event writer. Its `SummaryWriter` is not used, because it hands them to a
thread through a queue that blocks the training for ever once a full disk has ended that thread.
"""

import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary

FOLDER = "tensorboard"
RETRY_SECONDS = 60.0
"""Pause after a failure until the next file is begun: a full disk may take the file and not what goes into it."""


class TensorBoardWriter:
    """Appends scalars to an event file; without a directory it writes nothing.

    Args:
        directory: the run directory, or None.

    Attributes:
        failure: why the scalars could not be written, or empty.
    """

    def __init__(self, directory: Path | None) -> None:
        self.failure = ""
        self._folder = None if directory is None else directory / FOLDER
        self._writer: Any = None
        self._lost, self._again = 0, 0.0

    def write(self, step: int, scalars: Mapping[str, float]) -> None:
        """Append scalars by their names.

        Args:
            step: environment steps of the run.
            scalars: values; groups of names are divided by a slash.
        """
        values = [Summary.Value(tag=name, simple_value=value) for name, value in scalars.items()]
        self._put(Event(wall_time=time.time(), step=step, summary=Summary(value=values)))

    def resume(self, step: int) -> None:
        """Say that a run goes on from a step: TensorBoard then leaves out what stands beyond it in earlier files."""
        # It leaves out the step itself, too, which is not beyond.
        self._put(Event(wall_time=time.time(), step=step + 1, session_log=SessionLog(status=SessionLog.START)))

    def _put(self, event: Any) -> None:
        """Write an event; one that the disk does not take is counted, and after a while another file is begun."""
        if self._folder is None:
            return
        try:
            if self._writer is None:
                if time.monotonic() < self._again:
                    self._lost += 1
                    return
                self._folder.mkdir(exist_ok=True)
                # The library's names differ by the second only; two starts within one would share a file.
                start = len(list(self._folder.iterdir()))
                self._writer = EventsWriter(str(self._folder / "events"), f".{start}")
            self._writer.write_event(event)
            self._writer.flush()
        except OSError as error:
            self._lost += 1
            self.failure = f"TensorBoard's scalars cannot be written: {error.strerror or error}; {self._lost} are lost."
            self._writer, self._again = None, time.monotonic() + RETRY_SECONDS
        else:
            self.failure = f"{self._lost} events of TensorBoard's could not be written." if self._lost else ""

    def close(self) -> None:
        """Close the file; nothing is written any more."""
        if self._writer is not None:
            with suppress(OSError):  # each event was flushed, or counted
                self._writer.close()
        self._writer = self._folder = None


def flattened(values: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Return the numbers of nested maps by names with slashes between; whatever is no number is left out."""
    result: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            result |= flattened(value, f"{prefix}{name}/")
        elif isinstance(value, int | float):
            result[prefix + name] = float(value)
    return result
