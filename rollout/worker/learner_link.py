"""A worker's view of its learner: the parameters, imitation events and progress that the learner publishes."""

from eia_sec.common.clock import monotonic
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import method_of, read_saved
from eia_sec.common.errors import ProtocolError, UsageError
from eia_sec.common.log import log
from eia_sec.common.loops import Running
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.process import fetch_configuration
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.common.protocol.epoch_fence import EpochFence
from eia_sec.common.protocol.messages import ConfigurationMessage, ImitationMessage, ParametersMessage, ProgressMessage
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.bus import Bus

PATIENCE_SECONDS = 5.0
"""Time between two log lines of the wait for a new learner's configuration."""
RENEW_SECONDS, LONGEST_RENEW_SECONDS = 5.0, 60.0
"""Time without the parameters that the progress names after which they are asked for again; it doubles up to the second
one, since a slow link needs long for them."""
WAITING_PROGRESS = 8
"""Messages of progress that wait during a chunk. Were it one, a learner that has been replaced and does not know it yet
might hide that its successor sends, too, and be followed."""
COLLECTING = ("starting", "training")
"""States of a run in which workers collect."""


class LearnerLink:
    """Follows the learner between chunks.

    New parameters replace the worker's actors at once. Older parameters, and those of a replaced learner, are dropped
    and counted. An imitation event changes the actors once, whether it arrives before or after the parameters that
    contain it. `PolicyStore` does both. Of a state the newest value alone waits, so those of a learner that has been
    replaced may take the place of its successor's. Then the worker asks again: that learner may wait for it in turn.

    A higher epoch in the progress means that a new learner has taken over. The worker asks it for its configuration and
    follows it if that is the same, but for what a resumed run may change (`eia_sec.common.config.files.method_of`).
    Until the answer comes, it goes on as before. It follows a lower epoch only if the higher one has gone silent, see
    `EpochFence`.

    Args:
        control: the control lane.
        run: the run's name.
        worker: the worker's name.
        config: the run's configuration.
        team: layout of the actors.

    Attributes:
        store: the actors.
        state: state of the run: starting, training, draining or finished.
        epoch: the learner's fencing epoch, 0 before the first progress.
        newest_version: newest parameter version that the learner has published.
        window, asked_steps: environment steps that a worker may have under way, and those of its next chunk at most,
            as the learner last published.
        arguments: those that environments should have from their next episodes on; empty for what they have.
        heard_at: time of the learner's newest progress, by the monotonic clock.
        malformed: messages that were dropped.
    """

    def __init__(self, control: Bus, run: str, worker: str, config: RunConfig, team: TeamSpec) -> None:
        self._control, self._run, self._worker = control, run, worker
        self._method = method_of(config)
        self._parameters = control.subscribe_state(keys.PARAMETERS.key(run))
        self._missed, self._complete_at, self._renew_after = 0, monotonic(), RENEW_SECONDS
        self._events = control.subscribe_state(keys.IMITATION_EVENT.key(run))
        self._progress = control.subscribe_state(keys.PROGRESS.key(run), WAITING_PROGRESS)
        self.store = PolicyStore(team, config.module)
        self.state = "starting"
        self.epoch = self.newest_version = self.malformed = 0
        self.window = self.asked_steps = NO_LIMIT
        self.arguments = ""
        self.heard_at = monotonic()
        self._fence = EpochFence()
        self._ignored: ParametersMessage | None = None
        self._successor: ProgressMessage | None = None
        self._asked: Running[ConfigurationMessage | None] | None = None

    @property
    def alarm(self) -> str:
        """The alarm that a learner with a lower epoch is being ignored, or an empty string."""
        return self._fence.alarm

    @property
    def silence(self) -> float:
        """Seconds since the learner last published its progress."""
        return monotonic() - self.heard_at

    @property
    def missed(self) -> int:
        """Number of parameter messages that were lost on the way."""
        return self._missed + self._parameters.missed

    def poll(self) -> None:
        """Process the messages that have arrived; raise UsageError if a new learner has another configuration."""
        try:
            for heard in self._progress.drain():
                self._hear(ProgressMessage.decode(heard.payload))
            if self._asked is not None and self._asked.step():
                self._meet(self._asked.result)
            if (sample := self._parameters.poll()) is not None:
                self._offer(ParametersMessage.decode(sample.payload))
            if (sample := self._events.poll()) is not None:
                announced = ImitationMessage.decode(sample.payload)
                self.store.offer_imitation(announced.to_event(), announced.epoch)
        except ProtocolError as error:
            self.malformed += 1
            log(f"worker {self._worker}: dropped a message: {error}")
        self._renew_parameters()

    def _renew_parameters(self) -> None:
        """Ask for the newest parameters again where those that the progress names do not come."""
        now = monotonic()
        if self.epoch == 0 or (self.store.epoch, self.store.version) >= (self.epoch, self.newest_version):
            self._complete_at, self._renew_after = now, RENEW_SECONDS
        elif now - self._complete_at > self._renew_after:
            log(f"worker {self._worker} asks again for version {self.newest_version}, which has not come.")
            self._complete_at, self._renew_after = now, min(2.0 * self._renew_after, LONGEST_RENEW_SECONDS)
            self._missed += self._parameters.missed
            self._parameters = self._control.subscribe_state(keys.PARAMETERS.key(self._run))

    def _offer(self, message: ParametersMessage) -> None:
        self._ignored = message if message.epoch < self.store.epoch else None
        self.store.offer_parameters(message)

    def _hear(self, message: ProgressMessage) -> None:
        if not self._fence.admits(message.epoch, self.epoch):
            return
        if self.epoch in (0, message.epoch):
            if self._successor is not None and self._successor.epoch < message.epoch:
                self._successor = None  # it is not the only one that sends
            self._follow(message)
        else:
            self._successor = message
            self._asked = self._asked or Running(
                fetch_configuration(self._control, self._run, self._worker, lambda: True, PATIENCE_SECONDS)
            )

    def _meet(self, answer: ConfigurationMessage | None) -> None:
        """Follow the new learner if its configuration is the same."""
        self._asked, message, self._successor = None, self._successor, None
        if answer is not None and method_of(read_saved(answer.toml)) != self._method:
            raise UsageError(f"run {self._run} has a new learner with another configuration.")
        if message is not None:
            self._follow(message)

    def _follow(self, message: ProgressMessage) -> None:
        before = self.epoch
        self.epoch, self.state, self.newest_version = message.epoch, message.state, message.version
        self.window, self.asked_steps, self.arguments = message.window, message.asked_steps, message.arguments
        self.heard_at = monotonic()
        if message.epoch < before:
            self.store.follow_lower_epoch(message.epoch)
            if self._ignored is not None:
                self._offer(self._ignored)
