"""TensorBoard scalars in the run directory, beside metrics.jsonl: tensorboard --logdir RUN_DIR shows them.

Events are written at once by the library's event writer. Its `SummaryWriter` is not used, because it hands them to a
thread through a queue that blocks the training for ever once a full disk has ended that thread.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary

FOLDER = "tensorboard"


class Board:
    """Appends scalars to an event file; without a directory it writes nothing.

    Args:
        directory: the run directory, or None.

    Attributes:
        failure: why the scalars could not be written, or empty.
    """

    def __init__(self, directory: Path | None) -> None:
        self.failure = ""
        self._writer: Any = None
        if directory is not None:
            try:
                (directory / FOLDER).mkdir(exist_ok=True)
                # The library's names differ by the second only; two starts within one would share a file.
                start = len(list((directory / FOLDER).iterdir()))
                self._writer = EventsWriter(str(directory / FOLDER / "events"), f".{start}")
            except OSError as error:
                self._fail(error)

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
        if self._writer is None:
            return
        try:
            self._writer.write_event(event)
            self._writer.flush()
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            try:
                self._writer.close()
            except OSError as error:
                self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failure = f"TensorBoard's scalars could not be written: {error.strerror or error}."
        self._writer = None


def flattened(values: Mapping[str, Any], prefix: str = "") -> dict[str, float]:
    """Return the numbers of nested maps by names with slashes between; whatever is no number is left out."""
    result: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            result |= flattened(value, f"{prefix}{name}/")
        elif isinstance(value, int | float):
            result[prefix + name] = float(value)
    return result
