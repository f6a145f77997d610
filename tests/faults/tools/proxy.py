"""A proxy of messages between real workers and a real learner, which doubles, delays, cuts and flips requests."""

import random
import threading
from collections import Counter
from types import TracebackType
from typing import Self

from eia_sec.common.errors import BusError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ChunkAck
from eia_sec.common.transport.bus import Bus, Incoming
from eia_sec.common.transport.endpoint import Endpoint
from tests.faults.tools.channel import Parcel, Road, damage
from tests.faults.tools.network import Relay
from tests.system.fleet import RUN


class Proxy:
    """Stands at `here` for the learner at `there`: the control lane passes as bytes, transitions as messages.

    A worker has one request under way, so none of its own can overtake it: what comes late is an older one once more,
    behind newer ones.

    Attributes:
        here: where workers connect.
        road: what is done to requests, and how often it was done.
        verdicts: the verdicts that the learner answered with, those of copies included.
    """

    def __init__(self, here: Endpoint, there: Endpoint, road: Road, seed: int = 0) -> None:
        self.here, self.road, self.verdicts = here, road, Counter[str]()
        self._draw = random.Random(seed)
        self._older: dict[str, Parcel] = {}
        self._relay = Relay(here, there, lanes=(0,))
        self._front, self._back = Bus.listen(here, "bulk"), Bus.connect(there, "bulk", 30.0)
        self._server = self._front.serve(keys.TRANSITION.pattern(RUN), 64)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._front.close()
        self._thread.join()
        self._back.close()
        self._relay.close()

    def _run(self) -> None:
        for incoming in self._server:
            try:
                self._pass_on(incoming)
            except BusError as error:
                incoming.refuse(str(error))

    def _pass_on(self, incoming: Incoming) -> None:
        """Bring a request to the learner, with whatever befalls it, and the last answer back."""
        road, draw = self.road, self._draw
        older = self._older.get(incoming.key)
        if older is not None and draw.random() < road.reordered:
            road.done["reordered"] += 1
            self._ask(older)
        answer = None
        for copy in range(1 + (draw.random() < road.duplicated)):
            road.done["duplicated"] += copy
            parcel = Parcel(incoming.key, incoming.payload, incoming.attachment)
            _, place = damage(parcel, road, draw)
            answer = self._ask(parcel)
            road.done["unseen"] += answer is not None and place >= len(ChunkAck.decode(answer).verdicts)
        if answer is None:
            incoming.refuse("the learner does not answer.")
            return
        if draw.random() < 0.5:
            self._older[incoming.key] = Parcel(incoming.key, incoming.payload, incoming.attachment)
        incoming.reply(answer)

    def _ask(self, parcel: Parcel) -> bytes | None:
        answer = self._back.ask(parcel.key, parcel.payload, 30.0, parcel.attachment)
        if answer is not None:
            self.verdicts.update(ChunkAck.decode(answer).verdicts)
        return answer
