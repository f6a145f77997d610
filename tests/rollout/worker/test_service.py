"""A worker's own loop, where it may wait for others."""

import threading
from types import SimpleNamespace

from common.process import StopSignal
from common.protocol.messages import ProgressMessage
from common.transport.bus import Bus
from common.transport.endpoint import free_endpoint
from rollout.worker.service import Worker


def test_a_worker_stops_that_waits_for_a_new_learners_configuration():
    """A learner that said that it is new and then answers nobody does not keep its workers from ending."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control"), Bus.connect(endpoint, "control", 10.0) as bus:
        worker = SimpleNamespace(
            _epoch=1,
            _control=bus,
            _options=SimpleNamespace(run="r", name="0"),
            _toml="",
            _stop=StopSignal(),
            _sender=SimpleNamespace(hurry=lambda wanted: None),
        )
        message = ProgressMessage(2, 1, 0, 0, 0, 0, "training")
        thread = threading.Thread(target=Worker._follow, args=(worker, message))
        thread.start()
        thread.join(0.5)
        assert thread.is_alive()
        worker._stop.event.set()
        thread.join(60.0)
        assert not thread.is_alive()
