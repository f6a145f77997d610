"""A coordinator that is asked to stop while workers owe it an answer."""

import threading

from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import EvaluationOrder
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.elite.evaluation_plan import evaluation_plan
from eia_sec.elite.service import Coordinator, CoordinatorOptions
from tests.system.fleet import until

RUN = "stop"


def asking() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if "_ask_one" in thread.name]


def test_threads_that_still_ask_end_with_the_bus():
    """They outlive the stop, hold the process until the bus is closed, and end then."""
    endpoint, stop, config = free_endpoint(), StopSignal(), preset("eia-sec")
    farms, episodes = evaluation_plan(config, 1)
    with Bus.listen(endpoint, "control") as other:
        silent = other.serve(keys.EVALUATION.key(RUN, worker="w"), 4)
        with Bus.connect(endpoint, "control", wait=10.0) as bus:
            options = CoordinatorOptions(RUN, endpoint, "elite", 1.0)
            coordinator = Coordinator(options, config, farm_team(config.farm), bus)
            share = list(range(len(farms)))
            order = EvaluationOrder(1, 1, 1, tuple(farms), tuple(episodes))
            found = []
            turn = threading.Thread(target=lambda: found.append(coordinator._ask_all([("w", share, order)], [], stop)))
            turn.start()
            held = until(silent.poll, "a request for an evaluation")
            stop.event.set()
            turn.join(20.0)
            assert found == [{}]
            (thread,) = asking()
            assert not thread.daemon
        thread.join(20.0)
        assert not thread.is_alive()
        assert held is not None
