"""A flight node on the bus: it flies beside no living one of its name."""

import time

import pytest

from eia_sec.common.errors import UsageError
from eia_sec.common.process import Presence
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.flight.node import require_absent

SECONDS = 20.0


def test_a_node_whose_name_lives_is_refused():
    """Another name, another run, and the same name after the first has ended are none of its business."""
    where = free_endpoint()
    with Bus.listen(where, "control"), Bus.connect(where, "control", wait=SECONDS) as bus:
        require_absent(bus, "run", "main")
        with Bus.connect(where, "control", wait=SECONDS) as other:
            first = Presence(other, "run", "flight", "main", 1)
            _until(lambda: not _absent(bus, "main"))
            with pytest.raises(UsageError, match="a flight node main of run run is flying"):
                require_absent(bus, "run", "main")
            require_absent(bus, "run", "spare")
            require_absent(bus, "other", "main")
            assert first is not None
        _until(lambda: _absent(bus, "main"))


def _absent(bus, name):
    try:
        require_absent(bus, "run", name)
    except UsageError:
        return False
    return True


def _until(true):
    deadline = time.monotonic() + SECONDS
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.05)
