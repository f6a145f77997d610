"""A worker's view of its learner: the parameters, imitation events and progress that the learner publishes."""

import time

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import method_of, read_saved
from eia_sec.common.errors import ProtocolError, UsageError
from eia_sec.common.log import log
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.process import StopSignal, fetch_configuration
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.common.protocol.epoch_fence import EpochFence
from eia_sec.common.protocol.messages import ImitationMessage, ParametersMessage, ProgressMessage
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.bus import Bus

COLLECTING = ("starting", "training")
"""States of a run in which workers collect."""


class LearnerLink:
    """Follows the learner between chunks.

    New parameters replace the worker's actors at once. Older parameters, and those of a replaced learner, are dropped
    and counted. An imitation event changes the actors once, whether it arrives before or after the parameters that
    contain it. `PolicyStore` does both.

    A higher epoch in the progress means that a new learner has taken over. The worker follows it if its configuration
    is the same, but for what a resumed run may change (`eia_sec.common.config.files.method_of`). It follows a lower
    epoch only if the higher one has gone silent, see `EpochFence`.

    Args:
        control: the control lane.
        run: the run's name.
        worker: the worker's name.
        config: the run's configuration.
        team: layout of the actors.
        stop: ends the wait for a new learner's configuration.

    Attributes:
        store: the actors.
        state: state of the run: starting, training, draining or finished; unknown when a new learner has taken over
            whose configuration a worker that ends did not wait for.
        epoch: the learner's fencing epoch, 0 before the first progress.
        newest_version: newest parameter version that the learner has published.
        window: environment steps that a worker may have under way, as the learner last published.
        heard_at: time of the learner's newest progress, by the monotonic clock.
        malformed: messages that were dropped.
    """

    def __init__(
        self, control: Bus, run: str, worker: str, config: RunConfig, team: TeamSpec, stop: StopSignal
    ) -> None:
        self._control, self._run, self._worker, self._stop = control, run, worker, stop
        self._method = method_of(config)
        self._parameters = control.subscribe_state(keys.PARAMETERS.key(run))
        self._events = control.subscribe_state(keys.IMITATION_EVENT.key(run))
        self._progress = control.subscribe_state(keys.PROGRESS.key(run))
        self.store = PolicyStore(team)
        self.state = "starting"
        self.epoch = self.newest_version = self.malformed = 0
        self.window = NO_LIMIT
        self.heard_at = time.monotonic()
        self._fence = EpochFence()
        self._ignored: ParametersMessage | None = None

    @property
    def alarm(self) -> str:
        """The alarm that a learner with a lower epoch is being ignored, or an empty string."""
        return self._fence.alarm

    @property
    def silence(self) -> float:
        """Seconds since the learner last published its progress."""
        return time.monotonic() - self.heard_at

    @property
    def missed(self) -> int:
        """Number of parameter messages that were lost on the way."""
        return self._parameters.missed

    def poll(self) -> None:
        """Process the messages that have arrived; raise UsageError if a new learner has another configuration."""
        try:
            if (sample := self._progress.poll()) is not None:
                self._follow(ProgressMessage.decode(sample.payload))
            if (sample := self._parameters.poll()) is not None:
                self._offer(ParametersMessage.decode(sample.payload))
            if (sample := self._events.poll()) is not None:
                announced = ImitationMessage.decode(sample.payload)
                self.store.offer_imitation(announced.to_event(), announced.epoch)
        except ProtocolError as error:
            self.malformed += 1
            log(f"worker {self._worker}: dropped a message: {error}")

    def _offer(self, message: ParametersMessage) -> None:
        self._ignored = message if message.epoch < self.store.epoch else None
        self.store.offer_parameters(message)

    def _follow(self, message: ProgressMessage) -> None:
        before = self.epoch
        if not self._fence.admits(message.epoch, before):
            return
        if 0 < before != message.epoch:
            answer = fetch_configuration(self._control, self._run, self._worker, lambda: not self._stop, 5.0)
            if answer is None and self._stop:
                self.state = "unknown"
                return
            if answer is not None and method_of(read_saved(answer.toml)) != self._method:
                raise UsageError(f"run {self._run} has a new learner with another configuration.")
        self.epoch, self.state, self.newest_version = message.epoch, message.state, message.version
        self.window = message.window
        self.heard_at = time.monotonic()
        if message.epoch < before:
            self.store.follow_lower_epoch(message.epoch)
            if self._ignored is not None:
                self._offer(self._ignored)
