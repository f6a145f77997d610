"""TensorBoard scalars in the run directory; `tensorboard --logdir RUN_DIR` shows them.

We use the library's event writer, not its `SummaryWriter`, which passes events to a thread through a bounded queue.
When a full disk ends that thread, the queue fills up and blocks training forever.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.summary_pb2 import Summary, SummaryMetadata
from tensorboardX.summary import hparams

FOLDER = "tensorboard"
RETRY_SECONDS = 60.0
"""Pause after a failure before a new file is started; a full disk may accept a new file but not its contents."""


class TensorBoardWriter:
    """Appends scalars to an event file; without a directory it writes nothing.

    Args:
        directory: the run directory, or None.
        descriptions: descriptions of scalars, by name; not every scalar needs one.

    Attributes:
        failure: why scalars could not be written, or empty.
    """

    def __init__(self, directory: Path | None, descriptions: Mapping[str, str] | None = None) -> None:
        self.failure = ""
        self._folder = None if directory is None else directory / FOLDER
        self._writer: Any = None
        self._file: Path | None = None
        self._lost, self._removed, self._again = 0, 0, 0.0
        self._descriptions = dict(descriptions or {})

    def write(self, step: int, scalars: Mapping[str, float]) -> None:
        """Append scalars by their names.

        Args:
            step: environment steps of the run.
            scalars: values by name; slashes in a name separate groups.
        """
        values = [self._value(name, value) for name, value in scalars.items()]
        self._put(Event(wall_time=time.time(), step=step, summary=Summary(value=values)))

    def _value(self, name: str, value: float) -> Any:
        """Return a scalar, with its description when it is written for the first time."""
        found = self._descriptions.pop(name, None)
        shown_by = SummaryMetadata.PluginData(plugin_name="scalars")
        metadata = None if found is None else SummaryMetadata(summary_description=found, plugin_data=shown_by)
        return Summary.Value(tag=name, simple_value=value, metadata=metadata)

    def configuration(self, options: Mapping[str, bool | float | str], shown: Sequence[str]) -> None:
        """Record a run's configuration for the HPARAMS tab.

        Args:
            options: values by dotted key.
            shown: scalars that the tab shows beside them.
        """
        for summary in hparams(dict(options), dict.fromkeys(shown, 0.0)):
            self._put(Event(wall_time=time.time(), summary=summary))

    def resume(self, step: int) -> None:
        """Record that a run resumes at a step, so that TensorBoard drops later steps in earlier files."""
        # TensorBoard drops this event's step as well, but the checkpoint's own step stays valid.
        self._put(Event(wall_time=time.time(), step=step + 1, session_log=SessionLog(status=SessionLog.START)))

    def close(self) -> None:
        """Close the file; later scalars are dropped."""
        if self._writer is not None:
            with suppress(OSError):  # each event was flushed, or counted as lost
                self._writer.close()
        self._writer = self._folder = None

    def _put(self, event: Any) -> None:
        """Write an event, or count it as lost; RETRY_SECONDS after a failure, start a new file."""
        if self._folder is None:
            return
        try:
            if self._file is not None and self._writer is not None and not self._file.exists():
                self._removed += 1
                self._writer = None
            if self._writer is None:
                if time.monotonic() < self._again:
                    self._lost += 1
                    return
                self._open(self._folder)
            self._writer.write_event(event)
            self._writer.flush()
        except OSError as error:
            self._lost += 1
            self.failure = f"TensorBoard's scalars cannot be written: {error.strerror or error}; {self._lost} are lost."
            self._writer, self._again = None, time.monotonic() + RETRY_SECONDS
        else:
            self.failure = self._past_failures()

    def _open(self, folder: Path) -> None:
        """Start a new event file whose name sorts after those of earlier starts.

        TensorBoard reads files in the order of their names. The library's own names begin with the wall clock, so after
        a clock was set back, a new file would sort before earlier ones.
        """
        folder.mkdir(exist_ok=True)
        before = {path.name for path in folder.iterdir()}
        self._writer = EventsWriter(str(folder / f"events.start-{_next_start(before):06d}"))
        self._file = next((path for path in folder.iterdir() if path.name not in before), None)

    def _past_failures(self) -> str:
        lost = f"{self._lost} TensorBoard events could not be written." if self._lost else ""
        removed = "TensorBoard's event file was removed while in use; its scalars are gone." if self._removed else ""
        return f"{lost} {removed}".strip()


def _next_start(names: set[str]) -> int:
    """Return a number above those of all event files, and above their count."""
    numbers = [name.removeprefix("events.start-")[:6] for name in names if name.startswith("events.start-")]
    return max([len(names), *(int(number) for number in numbers if number.isdecimal())]) + 1
