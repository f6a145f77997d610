"""A coordinator that is asked to stop while workers owe it an answer."""

from eia_sec.common.config.presets import preset
from eia_sec.common.farm import farm_team
from eia_sec.common.loops import Running
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ProgressMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.elite.service import Coordinator, CoordinatorOptions
from tests.system.fleet import until

RUN = "stop"


def test_an_evaluation_that_nobody_answers_keeps_nobody():
    """The coordinator abandons the event at its next turn."""
    endpoint, stop, config = free_endpoint(), StopSignal(), preset("eia-sec")
    with Bus.listen(endpoint, "control") as other, Bus.connect(endpoint, "control", wait=10.0) as bus:
        silent = other.serve(keys.EVALUATION.key(RUN, worker="w"), 4)
        coordinator = Coordinator(CoordinatorOptions(RUN, endpoint, "elite", 1.0), config, farm_team(config.farm), bus)
        coordinator._workers.add("w")
        event = Running(coordinator._hold_event(ProgressMessage(1, 1, 0, 0, 0, 0, "training"), stop))

        def asked():
            assert not event.step()
            return silent.poll()

        held = until(asked, "a request for an evaluation")
        stop.event.set()
        until(event.step, "the end", 5.0)
        assert held is not None
