"""What a command tells the shell: 0 done, 1 failed, 2 a user's mistake, 130 interrupted."""

import os
import sys
from collections.abc import Callable
from typing import Final

from common.errors import EiaSecError, UsageError

DONE: Final = 0
FAILED: Final = 1
USAGE: Final = 2
INTERRUPTED: Final = 130
"""128 + SIGINT, as shells have it."""
PIPE_CLOSED: Final = 141
"""128 + SIGPIPE: the reader of the output went away, `| head` for instance."""


def run_command(command: Callable[[], int | None]) -> int:
    """Run a command and return its exit code; an expected error becomes one line on standard error.

    An exception that is none of EiaSecError is a defect and passes through with its traceback.

    Args:
        command: does the work; returns an exit code, or None for success.
    """
    try:
        code = command()
        sys.stdout.flush()
    except UsageError as error:
        return _complain(str(error), USAGE)
    except EiaSecError as error:
        return _complain(str(error) or type(error).__name__, FAILED)
    except KeyboardInterrupt:
        return _complain("interrupted.", INTERRUPTED)
    except BrokenPipeError:
        # The interpreter flushes standard output once more at exit, which must not fail a second time.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    return DONE if code is None else code


def _complain(sentence: str, code: int) -> int:
    sys.stderr.write(f"eia-sec: {sentence}\n")
    return code
