"""A router of the bulk lane, until killed: `python -m research.benchmarks.intake.router ENDPOINT`."""

import argparse
import json
import threading

import zenoh

from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.common.transport.zenoh_config import listening
from eia_sec.deploy.local.memory import keep_freed_memory


def main() -> None:
    """Route."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--shared-memory", action="store_true")
    options = parser.parse_args()
    keep_freed_memory()
    config = zenoh.Config()
    endpoint = Endpoint.parse(options.endpoint, shared_memory=options.shared_memory)
    for key, value in listening(endpoint, "bulk", mode="router").items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        threading.Event().wait()


if __name__ == "__main__":
    main()
