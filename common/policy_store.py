"""A process's copy of the actors, updated by newer parameters and by imitation events."""

from dataclasses import replace

from eia_sec.common.actors import TeamActors, checked_head, imitate
from eia_sec.common.config.algorithms.network import NetworkConfig
from eia_sec.common.errors import VersionError
from eia_sec.common.gru import checked_memory
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.protocol.messages import ParametersMessage
from eia_sec.common.team import Float32, TeamSpec


class PolicyStore:
    """The newest actors, with every known imitation event applied to them exactly once.

    Parameters carry the number of events that they contain. An event that the copy lacks is applied as soon as it
    arrives. If parameters arrive that the learner sent before it knew the event, the event is applied to them as well.

    Args:
        team: see below.
        module: options of the plug-in's network that the run trains; None for perceptrons.

    Attributes:
        team: the layout that all parameters must have.
        actors: the actors, or None before the first parameters.
        epoch: fencing epoch of the learner that sent them.
        version: their version.
        event: number of imitation events applied to them.
        environment_steps: environment steps that the learner had accepted when it sent them.
        progress: share of the run's episodes that were finished at that time, 0..1.
        ignored: messages that were ignored because they were not newer.
    """

    def __init__(self, team: TeamSpec, module: NetworkConfig | None = None) -> None:
        self.team, self._module = team, module
        self.actors: TeamActors | None = None
        self.epoch = 0
        self.version = 0
        self.event = 0
        self.environment_steps = 0
        self.progress = 0.0
        self.ignored = 0
        self._latest: ImitationEvent | None = None
        self._latest_epoch = 0

    def offer_parameters(self, message: ParametersMessage) -> bool:
        """Apply parameters if they are newer; return whether they were applied.

        Raises:
            VersionError: when they are for another team.
            SchemaError: when an array does not fit or is not finite.
        """
        if message.team != self.team.digest:
            raise VersionError(f"parameters for team {message.team[:16]} offered to team {self.team.digest}.")
        if (message.epoch, message.version) <= (self.epoch, self.version):
            self.ignored += 1
            return False
        arrays = tuple(flat.copy() for flat in message.flat)
        head, memory = checked_head(message.head), checked_memory(message.memory or "none")
        actors = TeamActors(self.team, message.hidden, arrays, head, memory, self._module)
        self.actors, self.epoch, self.version, self.event = actors, message.epoch, message.version, message.event
        self.environment_steps, self.progress = message.environment_steps, message.progress
        self._apply()
        return True

    def with_parameters(self, flat: tuple[Float32, ...]) -> TeamActors:
        """Return the actors with other parameters.

        Raises:
            VersionError: before the first parameters.
            SchemaError: when an array does not fit or is not finite.
        """
        if self.actors is None:
            raise VersionError("no parameters have arrived yet.")
        fitting = replace(self.actors, flat=flat)  # before anything is copied
        return replace(fitting, flat=tuple(part.copy() for part in flat))

    def offer_imitation(self, event: ImitationEvent, epoch: int) -> bool:
        """Take an imitation event of a learner's epoch; return whether it has now changed the actors.

        Raises:
            SchemaError: when the event does not fit the team.
        """
        event.check(self.team)
        newest = (self._latest_epoch, self._latest.event if self._latest else 0)
        if epoch >= self.epoch and (epoch, event.event) > newest:
            self._latest_epoch = epoch
            self._latest = event
            return self._apply()
        self.ignored += 1
        return False

    def follow_lower_epoch(self, epoch: int) -> None:
        """Accept parameters from this lower epoch on; the present actors stay until the first ones arrive."""
        self.epoch, self.version, self.event = epoch, 0, 0
        self._latest, self._latest_epoch = None, 0

    def _apply(self) -> bool:
        event = self._latest
        if event is None or self.actors is None or (self._latest_epoch, event.event) != (self.epoch, self.event + 1):
            return False
        for flat, elite in zip(self.actors.flat, event.elites, strict=True):
            imitate(flat, elite, event.rate)
        self.event = event.event
        return True
