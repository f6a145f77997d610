"""A Zenoh router as a process of its own, both lanes: `python -m tests.faults.tools.router CONTROL BULK`."""

import json
import sys
import time

import zenoh


def main() -> None:
    """Route until killed."""
    sessions = []
    for locator in sys.argv[1:]:
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("listen/endpoints", json.dumps([locator]))
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/link/tx/lease", "4000")
        sessions.append(zenoh.open(config))
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main()
