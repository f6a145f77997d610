"""Says each alarm once, where there is no terminal for the live view."""

import re
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from eia_sec.deploy.monitor.snapshot import Snapshot

REMEMBERED: Final = 1024
"""Most alarms that are remembered; beyond that, the oldest is forgotten."""
STANDING_SECONDS: Final = 2.0
"""Age from which an alarm is said: some hold only between two messages, as when processes leave at the end."""
SAID: Final = 8
"""Most alarms that are said at once; the rest are counted."""
_COUNT: Final = re.compile(r"(?<!rollout )(?<!flight )(?<![\w.-])\d[\d,.]*")
"""A number in an alarm, but for one that is a process's name: an alarm whose numbers grow is the same alarm."""


class NewAlarms:
    """Remembers which alarms were said.

    Args:
        clock: returns monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._since: dict[str, float] = {}
        self._said: OrderedDict[str, None] = OrderedDict()

    def of(self, snapshot: Snapshot) -> list[str]:
        """Return a line for each alarm that has stood for STANDING_SECONDS and was not said before."""
        now, standing = self._clock(), {_COUNT.sub("#", text): text for text in snapshot.alarms}
        self._since = {alarm: self._since.get(alarm, now) for alarm in standing}
        old = [alarm for alarm, since in self._since.items() if now - since >= STANDING_SECONDS]
        found = [f"alarm: {standing[alarm]}" for alarm in old if alarm not in self._said]
        for alarm in old:
            self._said[alarm] = None
            self._said.move_to_end(alarm)
        while len(self._said) > REMEMBERED:
            self._said.popitem(last=False)
        hidden = len(found) - SAID
        return [*found[:SAID], f"alarm: and {hidden} more."] if hidden > 0 else found
