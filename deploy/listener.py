"""The control lane of whoever listens at an endpoint; while a command waits for a listener, it says so."""

from collections.abc import Callable

from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.progress import Countdown


def connected(endpoint: Endpoint, patience: float, waiting: Callable[[], bool] = lambda: True) -> Bus:
    """Return a session with the control lane.

    Args:
        endpoint: where somebody should listen.
        patience: how long to wait for a listener, s.
        waiting: called meanwhile; False gives up.

    Raises:
        EndpointError: nobody answers there in time.
        CancelledError: `waiting` gave up.
    """
    with Countdown(f"a listener at {endpoint}", patience, waiting) as waits:
        return Bus.connect(endpoint, "control", patience, waits)
