"""Our intake: the learner's own receiver and replay, without training: `python -m research.benchmarks.intake.sink ...`.

Everything that a run does with a chunk until it can be drawn: checksum, decoding, checks of shapes and numbers,
deduplication, ledger, acknowledgement and the copy into replay.
"""

import argparse
import sys

from eia_sec.common.config import ReplayConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_environment
from eia_sec.common.loops import in_thread
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.local.memory import keep_freed_memory
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.intake.receiver import Receiver
from eia_sec.learner.off_policy.replay import Replay
from research.benchmarks.intake.chunks import CAPACITY, Window, write_result
from research.benchmarks.intake.record import configuration

RUN = "intake"
WAITING = 64
"""Requests that may wait; a learner has room for more."""


def main() -> None:
    """Take in until the window is over."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("--bytes", type=int, required=True, help="of the chunks that come")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--routed", action="store_true", help="the endpoint is a router's")
    parser.add_argument("--shared-memory", action="store_true")
    options = parser.parse_args()
    keep_freed_memory()
    endpoint = Endpoint.parse(options.endpoint, shared_memory=options.shared_memory)
    environment = farm_environment(preset("study").farm)
    team = environment.team
    replay, taken = Replay(team, CAPACITY), [0, 0]
    with Bus.connect(endpoint, "bulk", wait=30.0) if options.routed else Bus.listen(endpoint, "bulk") as bus:
        receiver = Receiver(
            bus.serve(keys.TRANSITION.pattern(RUN), WAITING),
            team,
            ChunkRules.of(configuration(options.bytes), environment),
            Ledger(),
            IntakeLimits(ReplayConfig().intake_chunks, None),
            lockstep=False,
        )
        receiving = in_thread("receiver", receiver.receive())
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        window = Window(lambda: (taken[0], taken[1]), options.seconds)
        while not window.over():
            if receiver.arrivals.empty():
                receiver.dealt_with.wait(0.02)
                receiver.dealt_with.clear()
                continue
            arrival = receiver.arrivals.get_nowait()
            rows, sender = arrival.chunk.rows, arrival.sender
            replay.add(rows, sender.version, f"{sender.name}/{sender.incarnation}", sender.sequence)
            taken[0] += rows.steps
            taken[1] += rows.observation.nbytes + rows.action.nbytes + rows.reward.nbytes
        write_result(window.report())
        receiver.close()
    receiving.join()


if __name__ == "__main__":
    main()
