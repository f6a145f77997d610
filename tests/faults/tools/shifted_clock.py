"""`eia-sec` with a clock that is wrong: `python -m tests.faults.tools.shifted_clock COMMAND...`.

The environment variable EIA_SEC_CLOCK_AHEAD says by how many seconds it is ahead.
"""

import os
import sys
import time

AHEAD = "EIA_SEC_CLOCK_AHEAD"


def main() -> None:
    """Shift the time of day, then run the command."""
    nanoseconds, right = int(float(os.environ[AHEAD]) * 1e9), time.time_ns
    time.time_ns = lambda: right() + nanoseconds
    from eia_sec.deploy.cli import main as command  # noqa: PLC0415  # after the shift, so that nothing has the right clock

    sys.exit(command())


if __name__ == "__main__":
    main()
