"""Exit codes: 0 done, 1 failed, 2 a user's mistake, 3 a group of learners broke, 130 interrupted, 143 SIGTERM."""

import errno
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TextIO

from eia_sec.common.errors import CancelledError, EiaSecError, GroupError, UsageError
from eia_sec.common.text import printable_lines
from eia_sec.deploy.output import FULL

DONE: Final = 0
FAILED: Final = 1
USAGE: Final = 2
GROUP: Final = 3
"""The learner's group has lost a member, or its members differ; a supervisor starts all of it again."""
INTERRUPTED: Final = 130
"""128 + SIGINT, as in shells."""
PIPE_CLOSED: Final = 141
"""128 + SIGPIPE: the reader of the output, such as `| head`, has exited."""
OUR_CODES: Final = (DONE, FAILED, USAGE, GROUP, INTERRUPTED, PIPE_CLOSED, 143)
"""All that a command of ours ends with; the last is 128 + SIGTERM."""
CLOSED: Final = (errno.EACCES, errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)
"""Errors of paths that lead nowhere or where this user may not go."""


def run_command(command: Callable[[], int | None]) -> int:
    """Run a command and return its exit code.

    An expected error, a path that cannot be used and a full disk become one line on standard error. Any other exception
    is a defect and passes through with its traceback.

    Args:
        command: does the work; returns an exit code, or None for success.
    """
    try:
        code = _flushed(command)
    except EiaSecError as error:
        # Whoever is ended while it waits has done what it was asked to.
        said = str(error) or type(error).__name__
        return DONE if isinstance(error, CancelledError) else _complain(said, _code(error))
    except KeyboardInterrupt:
        return _complain("interrupted.", INTERRUPTED)
    except BrokenPipeError:
        _leave(sys.stdout)
        return PIPE_CLOSED
    except OSError as error:
        return _complain(*_of_system(error))
    return DONE if code is None else code


def _code(error: EiaSecError) -> int:
    if isinstance(error, UsageError):
        return USAGE
    return GROUP if isinstance(error, GroupError) else FAILED


def _flushed(command: Callable[[], int | None]) -> int | None:
    """Run a command and flush its output, also where it exits by itself, as `--help` does."""
    try:
        code = command()
    except SystemExit:
        sys.stdout.flush()
        raise
    sys.stdout.flush()
    return code


def _of_system(error: OSError) -> tuple[str, int]:
    """Return a sentence and an exit code for a full disk or a path that cannot be used; raise any other error."""
    if error.errno in CLOSED and error.filename is not None:
        return f"{error.filename} cannot be used: {error.strerror}.", USAGE
    if error.errno not in FULL:
        raise error
    if error.filename is None:
        _leave(sys.stdout)
    return f"{error.filename or 'the output'} cannot be written: {error.strerror}.", FAILED


def _leave(stream: TextIO) -> None:
    """Point a stream at /dev/null, so that the flush at exit does not fail a second time."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _complain(sentence: str, code: int) -> int:
    # What cannot be said, because standard error is closed or its disk full, must not change the exit code.
    try:
        sys.stderr.write(f"eia-sec: {printable_lines(sentence)}\n")
        sys.stderr.flush()
    except (OSError, ValueError, AttributeError):
        with suppress(OSError, ValueError, AttributeError):
            _leave(sys.stderr)  # or the flush at exit fails again, and changes the code
    return code
