"""Many workers in one process, each playing the same recorded chunk: `python -m benchmarks.intake.player ...`.

Each has one request under way, as a worker has; they speak the whole protocol, with sequence numbers and checksums.
"""

import argparse
import json
import time
from typing import Any

import zenoh

from benchmarks.intake.record import record
from benchmarks.intake.sink import RUN
from common import keys
from common.chunks import to_message
from common.config import FarmConfig
from common.endpoint import Endpoint
from common.messages import ChunkAck, ChunkMessage, Envelope
from common.team import farm_team
from common.zenoh_config import connecting


class Worker:
    """One worker: what it has sent, and the answer that it waits for."""

    def __init__(self, session: zenoh.Session, name: str, message: ChunkMessage, steps: int) -> None:
        self._session, self._name, self._message, self._steps = session, name, message, steps
        self._key = keys.TRANSITION.key(RUN, worker=name)
        self.sequence = 0
        self._replies: Any = None

    def send(self) -> None:
        """Send the next chunk."""
        self.sequence += 1
        done = self.sequence * self._steps
        parts = {**vars(self._message), "oldest": self.sequence, "produced": done, "flown": done}
        envelope = Envelope("rollout", self._name, 1, self.sequence, 1)
        self._replies = self._session.get(
            self._key,
            zenoh.handlers.FifoChannel(4),
            payload=ChunkMessage(**parts).encode(),
            attachment=envelope.encode(),
            timeout=30.0,
            congestion_control=zenoh.CongestionControl.BLOCK,
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def answered(self) -> bool:
        """Return whether the answer is there; raise RuntimeError when it is another than "accepted"."""
        reply = self._replies.try_recv()
        if reply is None:
            return False
        status = ChunkAck.decode(reply.ok.payload.to_bytes()).status if reply.ok is not None else str(reply.err)
        if status != "accepted":
            raise RuntimeError(f"chunk {self.sequence} of {self._name}: {status}")
        return True


def main() -> None:
    """Play until killed, or until nobody listens any more."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--bytes", type=int, required=True)
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--name", default="p")
    parser.add_argument("--shared-memory", action="store_true")
    options = parser.parse_args()
    chunk = record(options.bytes)
    message = to_message(chunk, farm_team(FarmConfig()), 1, 0, 0)
    endpoint = Endpoint.parse(options.endpoint, shared_memory=options.shared_memory)
    config = zenoh.Config()
    for key, value in connecting(endpoint, "bulk").items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        workers = [Worker(session, f"{options.name}{n}", message, chunk.rows.steps) for n in range(options.workers)]
        for worker in workers:
            worker.send()
        while True:
            idle = True
            for worker in workers:
                try:
                    if not worker.answered():
                        continue
                except (zenoh.ZError, RuntimeError):
                    return
                worker.send()
                idle = False
            if idle:
                time.sleep(0.0001)


if __name__ == "__main__":
    main()
