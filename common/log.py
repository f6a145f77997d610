"""The log of a process: one line for each thing that happens, on standard error, for people or as JSON for shippers."""

import atexit
import datetime
import json
import os
import sys
import time
from typing import Final

from eia_sec.common.text import printable

FORMAT: Final = "EIA_SEC_LOG_FORMAT"
"""Environment variable with the format, text or json; processes inherit it from the one that starts them."""
FORMATS: Final = ("text", "json")
SEPARATOR: Final = "\n  | "
"""Separates the lines of one log entry."""
_process: Final = {"role": "", "name": ""}
_unwritten: Final = [0]
"""Number of entries lost since the last one that was written."""


def name_process(role: str, name: str) -> None:
    """Set the role and the name that entries in JSON carry, such as rollout and 0."""
    _process.update(role=role, name=name)


def log(text: str) -> None:
    """Write one entry with its time, control characters made printable.

    In JSON an entry is one line: an object with time (UTC, ISO 8601), role, name, pid, message and unwritten, the
    number of entries that were lost just before it.

    A full disk does not stop the process. Entries that cannot be written are counted; the next one that can be written
    states how many are missing. If there is none before, a last one does so when the process ends.
    """
    try:
        sys.stderr.write(_entry(text))
        sys.stderr.flush()
    except (OSError, ValueError, AttributeError):  # the latter where there is no standard error at all
        _unwritten[0] += 1
    else:
        _unwritten[0] = 0


def _entry(text: str) -> str:
    parts = [printable(part) for part in text.split(SEPARATOR)]
    if os.environ.get(FORMAT) == "json":
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        entry = {"time": now, **_process, "pid": os.getpid(), "message": "\n".join(parts), "unwritten": _unwritten[0]}
        return json.dumps(entry, ensure_ascii=False) + "\n"
    before = f"({_unwritten[0]} lines before this one could not be written) " if _unwritten[0] else ""
    return f"{time.strftime('%H:%M:%S')} {before}{SEPARATOR.join(parts)}\n"


@atexit.register
def _close_log() -> None:
    if _unwritten[0]:
        log("this process ends.")
