"""Many workers in one process, each playing the same recorded chunk: `python -m research.benchmarks.intake.player ...`.

Each has one request under way, as a worker has, with as many chunks as its spool holds and a request takes; they speak
the whole protocol, with sequence numbers and checksums.
"""

import argparse
import json
import time
from dataclasses import replace
from typing import Any

import zenoh

from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import fitting, to_message, to_request
from eia_sec.common.protocol.messages import ChunkAck, ChunkMessage, Envelope
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.common.transport.zenoh_config import connecting
from eia_sec.deploy.local.memory import keep_freed_memory
from research.benchmarks.intake.record import record
from research.benchmarks.intake.sink import RUN


class Worker:
    """One worker: what it has sent, and the answer that it waits for.

    Args:
        session: shared by all.
        name: its own.
        message: the chunk that it plays.
        steps: environment steps in it.
        chunks: how many are under way at once.
    """

    def __init__(self, session: zenoh.Session, name: str, message: ChunkMessage, steps: int, chunks: int) -> None:
        self._session, self._name, self._message, self._steps = session, name, message, steps
        self._key = keys.TRANSITION.key(RUN, worker=name)
        self._chunks = chunks
        self.sent = 0
        self._replies: Any = None

    def send(self) -> None:
        """Seal the next chunks and send them."""
        first, sealed = self.sent + 1, []
        for _ in range(self._chunks):
            self.sent += 1
            sealed.append(replace(self._message, produced=self.sent * self._steps).encode())
        envelope = Envelope("rollout", self._name, 1, first, 1)
        self._replies = self._session.get(
            self._key,
            zenoh.handlers.FifoChannel(4),
            payload=to_request(sealed, first, self.sent * self._steps),
            attachment=envelope.encode(),
            timeout=30.0,
            congestion_control=zenoh.CongestionControl.BLOCK,
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def answered(self) -> bool:
        """Return whether the answer is there; raise RuntimeError when it is not that all were accepted."""
        reply = self._replies.try_recv()
        if reply is None:
            return False
        verdicts = ChunkAck.decode(reply.ok.payload.to_bytes()).verdicts if reply.ok is not None else str(reply.err)
        if verdicts != ("accepted",) * self._chunks:
            raise RuntimeError(f"chunks up to {self.sent} of {self._name}: {verdicts}")
        return True


def in_flight(size: int, spool: int) -> int:
    """Return how many chunks of `size` bytes of a spool are under way at once: one request's."""
    return fitting([len(a_message(size)[0].encode())] * spool)


def a_message(size: int) -> tuple[ChunkMessage, int]:
    """Return a recorded chunk of about `size` bytes as a message, and its environment steps."""
    chunk = record(size)
    return to_message(chunk, farm_team(preset("study").farm), 1, 0), chunk.rows.steps


def main() -> None:
    """Play until killed, or until nobody listens any more."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--bytes", type=int, required=True)
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--chunks", type=int, default=1, help="under way at once from each worker")
    parser.add_argument("--name", default="p")
    parser.add_argument("--shared-memory", action="store_true")
    options = parser.parse_args()
    keep_freed_memory()
    message, steps = a_message(options.bytes)
    endpoint = Endpoint.parse(options.endpoint, shared_memory=options.shared_memory)
    config = zenoh.Config()
    for key, value in connecting(endpoint, "bulk").items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        workers = [
            Worker(session, f"{options.name}{n}", message, steps, options.chunks) for n in range(options.workers)
        ]
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
