"""A worker follows its learner, and may always be ended while it waits for one."""

import threading

from common.process import StopSignal
from common.protocol.messages import ProgressMessage
from common.team import GroupSpec, TeamSpec
from common.transport.bus import Bus
from common.transport.endpoint import free_endpoint
from rollout.worker.learner_link import LearnerLink


def test_a_worker_stops_that_waits_for_a_new_learners_configuration():
    """A learner that said that it is new and then answers nobody does not keep its workers from ending."""
    endpoint, stop = free_endpoint(), StopSignal()
    with Bus.listen(endpoint, "control"), Bus.connect(endpoint, "control", 10.0) as bus:
        learner = LearnerLink(bus, "r", "0", "", TeamSpec((GroupSpec("one", 2, 3, 2),)), stop)
        learner.epoch = 1
        thread = threading.Thread(target=learner._follow, args=(ProgressMessage(2, 1, 0, 0, 0, 0, "training"),))
        thread.start()
        thread.join(0.5)
        assert thread.is_alive()
        stop.event.set()
        thread.join(60.0)
        assert not thread.is_alive()
        assert (learner.epoch, learner.state) == (2, "training")
