"""A worker gone mad, as a process of its own: `python -m tests.faults.tools.flooder LOCATOR KEY SECONDS`.

It keeps many requests of junk under way at once, whatever the answers say, and prints how many it made.
"""

import json
import sys
import time
from collections import deque
from typing import Any

import zenoh

UNDER_WAY = 64
JUNK = b"junk" * 32_768


def main() -> None:
    """Flood for some seconds."""
    locator, key, seconds = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([locator]))
    config.insert_json5("scouting/multicast/enabled", "false")
    waiting: deque[Any] = deque()
    made = 0
    with zenoh.open(config) as session:
        deadline = time.monotonic() + float(seconds)
        while time.monotonic() < deadline:
            waiting.append(session.get(key, zenoh.handlers.FifoChannel(4), payload=JUNK, timeout=5.0))
            made += 1
            if len(waiting) >= UNDER_WAY:
                for _ in waiting.popleft():
                    pass
    sys.stdout.write(json.dumps({"requests": made}) + "\n")


if __name__ == "__main__":
    main()
