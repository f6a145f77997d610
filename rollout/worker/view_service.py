"""Watching a worker or a flight node: its watchers, their leases, and the frames that it publishes.

Nothing is recorded or published unless somebody has asked in the last LEASE_SECONDS. A worker simulates an episode in a
fraction of a second, but people need many seconds to watch it. So the service shows one whole episode, step by step,
and pauses until STEPS_PER_SECOND allows the next. Steps in between count as skipped and are never queued.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, Protocol

from eia_sec.common.errors import ConfigError, ProtocolError
from eia_sec.common.names import check_name
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, StepsMessage, ViewMessage, WatchRequest, WatchTerms
from eia_sec.common.protocol.view_checks import MOST_AGENT_NAME
from eia_sec.common.text import printable
from eia_sec.common.transport.bus import Bus, Incoming
from eia_sec.rollout.envs.base import Environments
from eia_sec.rollout.followed_farm import FollowedFarm
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.worker.collector import StepObserver
from eia_sec.rollout.worker.farm_probe import FarmProbe
from eia_sec.rollout.worker.probe import Probe

LEASE_SECONDS: Final = 4.0
"""Time after its last request at which a watcher counts as gone."""
STEPS_PER_SECOND: Final = 25.0
"""Frames published in a second, on average."""
SLACK_SECONDS: Final = 1.0
"""How far publishing may run ahead of STEPS_PER_SECOND before the probe pauses after an episode."""
GREETING_SECONDS: Final = 2.0
"""Least time between two episodes that are shown early because a new watcher came."""
MAX_WATCHERS: Final = 16
CAPACITY: Final = 32
"""Requests that may wait."""


class Watched(Protocol):
    """What a process shows: a worker's `Collector`, for instance.

    Attributes:
        probe: records the first environment while somebody watches, else None.
    """

    probe: StepObserver | None

    @property
    def environments(self) -> Environments:
        """Return the batch, whose first environment is shown."""

    @property
    def simulated(self) -> int:
        """Return the steps of all environments so far."""


class ViewService:
    """Publishes frames of a process's first environment to watchers.

    Args:
        bus: the control lane.
        run: the run's name.
        worker: the name of the worker or flight node.
        incarnation: number of this start.
        collector: whose environments are shown.
        toml: the run's configuration.
        silence: why no environment's code is to draw pictures, a sentence, or empty.
        note_drawing: see `eia_sec.rollout.envs.pettingzoo_batch.PettingZooBatch`.
        clock: returns seconds.
        role: rollout or flight.

    Attributes:
        shown: frames published.
        skipped: steps collected while somebody watched, and not shown.
        refused: requests that were refused.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        worker: str,
        incarnation: int,
        collector: Watched,
        toml: str,
        silence: str = "",
        note_drawing: Callable[[bool], None] = lambda drawing: None,
        clock: Callable[[], float] = time.monotonic,
        role: str = "rollout",
    ) -> None:
        self._requests = bus.serve(keys.WATCH.key(run, worker=worker), CAPACITY, newest=True)
        self._publisher = bus.publish(keys.VIEW.key(run, worker=worker), keys.VIEW.encoding)
        self._sender = (role, worker, incarnation)
        self._collector, self._clock = collector, clock
        self._probe, self._terms = _probe(collector.environments, toml, silence, note_drawing)
        self._until: dict[str, float] = {}
        self._sequence = self.shown = self.skipped = self.refused = 0
        self._flown = self._seen = 0
        self._paid = self._greeted = 0.0

    @property
    def watchers(self) -> int:
        """Return the number of watchers."""
        return len(self._until)

    @property
    def pictures(self) -> int:
        """Return the number of pictures that the environment's code has drawn."""
        return self._probe.pictures

    @property
    def silence(self) -> str:
        """Return why the environment's code draws no pictures, a sentence, or an empty text."""
        return self._probe.silence

    def poll(self, version: int, noise_std: float, uniform: bool) -> None:
        """Answer requests, drop watchers that are gone, and publish the frames since the last call.

        Args:
            version: parameter version of the actors.
            noise_std: standard deviation of the exploration noise.
            uniform: whether actions were drawn uniformly instead.
        """
        for incoming in self._requests.waiting():
            self._answer(incoming)
        if not self._until:
            return
        now = self._clock()
        self._until = {name: until for name, until in self._until.items() if until > now}
        if not self._until:
            self._probe.close()
            self._probe.take(0, 0.0, False)
            self._collector.probe = None
            return
        self._publish(self._probe, now, version, noise_std, uniform)
        if not self._probe.is_open:
            self._collector.probe = None
            if now >= self._paid:
                self._open(self._probe, at_once=False)

    def _answer(self, incoming: Incoming) -> None:
        try:
            request = WatchRequest.decode(incoming.payload)
            check_name(request.watcher, "watcher")
            if request.stay and request.watcher not in self._until and len(self._until) >= MAX_WATCHERS:
                raise ConfigError(f"{MAX_WATCHERS} watchers are watching already.")
        except (ProtocolError, ConfigError) as error:
            self.refused += 1
            incoming.refuse(str(error))
            return
        incoming.reply(self._terms)
        if not request.stay:
            # The next call of `poll` drops it, and closes the probe after the last one.
            if request.watcher in self._until:
                self._until[request.watcher] = 0.0
            return
        new = request.watcher not in self._until
        self._until[request.watcher] = self._clock() + LEASE_SECONDS
        if new:
            self._greet(self._probe)

    def _greet(self, probe: Probe[Any, Any]) -> None:
        """Show a new watcher something soon: the running episode if nobody watched before, else the next one."""
        now = self._clock()
        if len(self._until) == 1:
            self._flown = self._steps() - self._seen - self.skipped
            self._paid = now
            self._open(probe, at_once=True)
        elif not probe.is_open and now - self._greeted >= GREETING_SECONDS:
            self._paid = now
        self._greeted = now

    def _open(self, probe: Probe[Any, Any], *, at_once: bool) -> None:
        probe.open(at_once=at_once)
        self._collector.probe = probe

    def _publish(self, probe: Probe[Any, Any], now: float, version: int, noise_std: float, uniform: bool) -> None:
        for message in probe.take(self.skipped, noise_std, uniform):
            self._put(message, version)
            self._paid = max(now, self._paid) + message.frames / STEPS_PER_SECOND
        self.skipped = max(self.skipped, self._steps() - self._flown - self._seen)
        probe.again = self._paid - now <= SLACK_SECONDS

    def _put(self, message: ViewMessage | StepsMessage, version: int) -> None:
        self._sequence += 1
        self.shown += message.frames
        self._seen += message.frames - (message.first == 0)
        self._publisher.put(message.encode(), Envelope(*self._sender, self._sequence, version).encode())

    def _steps(self) -> int:
        """Return the steps of the shown environment."""
        return self._collector.simulated // len(self._collector.environments.time)


def _probe(
    environments: Environments, toml: str, silence: str, note_drawing: Callable[[bool], None]
) -> tuple[Probe[Any, Any], bytes]:
    """Return what records a worker's first environment, and the terms of watching it."""
    terms = WatchTerms(toml, (), LEASE_SECONDS, STEPS_PER_SECOND)
    if isinstance(environments, FarmBatch):
        # Nobody tells what vehicles used and saw, so there are no rewards.
        names: tuple[str, ...] = () if isinstance(environments, FollowedFarm) else REWARD_PARTS
        return FarmProbe(environments, 0, len(names)), replace(terms, part_names=names).encode()
    from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch  # noqa: PLC0415  # pettingzoo loads only for its users
    from eia_sec.rollout.envs.vectorised import VectorisedBatch  # noqa: PLC0415  (likewise)
    from eia_sec.rollout.worker.environment_probe import EnvironmentProbe  # noqa: PLC0415  (likewise)

    if not isinstance(environments, PettingZooBatch | VectorisedBatch):
        raise TypeError(f"nothing records a {type(environments).__name__}.")
    environments.note_drawing = note_drawing
    names = tuple(printable(str(name))[:MOST_AGENT_NAME] for name in environments.names)
    probe = EnvironmentProbe(environments, 0, STEPS_PER_SECOND, silence)
    return probe, replace(terms, agents=names, team=environments.team.to_dict()).encode()
