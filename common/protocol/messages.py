"""Every message type of the protocol, one dataclass each; `keys` says where it travels, `codec` makes a frame of it."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.imitation import ImitationEvent
from common.protocol.codec import Message
from common.protocol.frame import MAX_HEADER
from common.team import Float32

MOST_CHUNKS: Final = 64
"""Most chunks that one delivery holds."""
MOST_BYTES: Final = 2 * 2**20
"""Most bytes of a delivery's chunks, when there are several; a single one may be larger."""
SETTLED: Final = ("accepted", "duplicate", "refused")
"""Verdicts after which a worker lets go of a chunk; the others ask for it again."""


@dataclass(frozen=True)
class Envelope(Message):
    """Who sent a payload; travels as its attachment.

    Attributes:
        role: rollout, learner, elite, flight or vehicle.
        name: the process's name inside its role.
        incarnation: a number that grows with every start of a process of this name.
        sequence: running number of what this sender sends on this key, from 1; the coordinator's is always 1.
        version: parameter version that the sender held.
    """

    KIND = 1
    role: str
    name: str
    incarnation: int
    sequence: int
    version: int = 0


@dataclass(frozen=True)
class ChunkMessage(Message):
    """Rows of transitions and the episodes that ended in them; travels inside a delivery.

    Attributes:
        team: digest of the team layout.
        version: parameter version that flew them.
        produced: environment steps that this incarnation has produced up to and with this chunk.
        observation, action, reward, flag: the rows, see `common.transitions.Rows`.
        farm, episode, steps: [K] int64 for each finished episode.
        episode_reward: [K, agents] float32.
        episode_metrics: [K, F] float64, the episode metrics of the environment.
        metric_names: F names.
    """

    KIND = 2
    team: str
    version: int
    produced: int
    observation: Float32
    action: Float32
    reward: Float32
    flag: NDArray[np.uint8]
    farm: NDArray[np.int64]
    episode: NDArray[np.int64]
    steps: NDArray[np.int64]
    episode_reward: Float32
    episode_metrics: NDArray[np.float64]
    metric_names: tuple[str, ...]


@dataclass(frozen=True)
class ChunkAck(Message):
    """The learner's answer to a delivery: verdicts on its chunks, from the first up to one that has to come again.

    Attributes:
        verdicts: accepted, duplicate or refused; the last may be gap, damaged (send it again), closed (nothing more is
            taken) or replaced (a newer start of the worker delivers); those behind it were not looked at.
        reasons: for each of them why it was not taken, else empty.
        expected: the next sequence number that the learner takes from this worker.
        required_version: parameter version that the worker must hold before its next chunk; 0 asks for none.
    """

    KIND = 3
    verdicts: tuple[str, ...]
    reasons: tuple[str, ...]
    expected: int
    required_version: int


@dataclass(frozen=True)
class ParametersMessage(Message):
    """All actors, at one version.

    Attributes:
        epoch: the learner's fencing epoch; parameters of a lower epoch are never applied.
        version: grows with every publication.
        event: number of imitation events that are in these parameters.
        environment_steps: steps that the learner had accepted.
        progress: share of the run's episodes that are done, 0..1.
        team: digest of the team layout.
        hidden: width of the hidden layers.
        head: kind of the last layer, deterministic or gaussian.
        flat: for each type, [n_v, P_v] float32, see `common.actors`.
    """

    KIND = 4
    epoch: int
    version: int
    event: int
    environment_steps: int
    progress: float
    team: str
    hidden: int
    head: str
    flat: tuple[Float32, ...]


@dataclass(frozen=True)
class ProgressMessage(Message):
    """Where the learner stands; small, sent often.

    Attributes:
        epoch: the learner's fencing epoch.
        version: newest published parameter version.
        events: imitation events applied.
        episodes: training episodes finished.
        environment_steps: environment steps accepted.
        updates: updates done.
        state: starting, training, draining or finished.
    """

    KIND = 5
    epoch: int
    version: int
    events: int
    episodes: int
    environment_steps: int
    updates: int
    state: str


@dataclass(frozen=True)
class CommandMessage(Message):
    """A command for the learner; its key ends in one of `common.protocol.keys.VERBS`."""

    KIND = 6
    sender: str


@dataclass(frozen=True)
class ConfigurationMessage(Message):
    """What a process needs to take part.

    Attributes:
        epoch: the learner's fencing epoch.
        toml: the run's configuration.
        team: the team's layout, see `common.team.TeamSpec.to_dict`.
        lockstep: whether worker and learner take turns.
        newest_start: greatest start number (incarnation) of the asking worker that the learner knows, 0 for none.
    """

    KIND, MOST_HEADER = 7, MAX_HEADER
    epoch: int
    toml: str
    team: dict[str, Any]
    lockstep: bool
    newest_start: int = 0


@dataclass(frozen=True)
class ReceiptMessage(Message):
    """A yes or a no with its reason."""

    KIND = 8
    done: bool
    reason: str


@dataclass(frozen=True)
class EvaluationOrder(Message):
    """A request for noise-free episodes.

    Attributes:
        epoch: the learner's fencing epoch.
        event: the imitation event that they are for.
        version: parameter version that the worker must at least hold.
        farms: farm seeds, one episode on each.
        episodes: episode seeds.
    """

    KIND = 9
    epoch: int
    event: int
    version: int
    farms: tuple[int, ...]
    episodes: tuple[int, ...]


@dataclass(frozen=True)
class EvaluationResult(Message):
    """Noise-free episodes, step by step.

    Attributes:
        event: the imitation event that they are for.
        version: parameter version that was evaluated.
        reward: [F, T, agents] float32 step rewards R_v-i; zeros behind the end of a shorter episode.
        steps: [F] int64 steps of each episode, at most T.
    """

    KIND = 10
    event: int
    version: int
    reward: Float32
    steps: NDArray[np.int64]


@dataclass(frozen=True)
class ImitationMessage(Message):
    """One imitation event, see `common.imitation.ImitationEvent`, and the learner's epoch that it belongs to.

    Attributes:
        epoch: the learner's fencing epoch.
        event: number e of the event, from 1.
        version: parameter version that was evaluated.
        episode: training episode at which it was due.
        rate: vartheta, the share by which actors move towards the elite.
        elites: for each type, the index of the elite inside it.
        scores: for each type, omega of each of its agents.
        evaluation_steps: environment steps flown for it.
    """

    KIND = 11
    epoch: int
    event: int
    version: int
    episode: int
    rate: float
    elites: tuple[int, ...]
    scores: tuple[tuple[float, ...], ...]
    evaluation_steps: int

    @classmethod
    def of(cls, event: ImitationEvent, epoch: int) -> "ImitationMessage":
        """Return the message of an event."""
        return cls(epoch=epoch, **vars(event))

    def to_event(self) -> ImitationEvent:
        """Return the event; it is not yet checked against a team."""
        return ImitationEvent(**{name: value for name, value in vars(self).items() if name != "epoch"})


@dataclass(frozen=True)
class MetricMessage(Message):
    """A lossy report of one process.

    Attributes:
        counter: grows by one with each report, so that gaps can be seen.
        host: the machine's name.
        pid: the process's number.
        uptime: seconds since start.
        values: metrics by name, see `common.protocol.metrics`; numbers, strings, lists and maps of them.
    """

    KIND, MOST_HEADER = 12, 256 * 1024
    counter: int
    host: str
    pid: int
    uptime: float
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ObservationMessage(Message):
    """What one vehicle sees; its envelope bears the role `vehicle`, and a sequence number that grows.

    Attributes:
        agent: the agent whose actor is to decide, communication_0 for instance.
        stamp: when it was observed, microseconds since 1970 by the vehicle's clock.
        values: [o] float32 of the agent's observation, scaled as the actor knows them.
    """

    KIND = 13
    agent: str
    stamp: int
    values: Float32


@dataclass(frozen=True)
class SetpointMessage(Message):
    """What one vehicle is to do until the next one comes.

    Attributes:
        agent: the agent that decided.
        velocity: along x and along y of the field, m/s; zeros command hover.
        hover: whether the watchdog commands hover; the velocity is then zero.
        reason: why, or empty.
        answers: sequence number of the observation that was decided on; 0 with hover.
        stamp: that observation's stamp; 0 with hover.
        period: running number of the flight node's period, from 1.
        latency: seconds from taking the observation in to this message; 0 with hover.
    """

    KIND = 14
    agent: str
    velocity: tuple[float, ...]
    hover: bool
    reason: str
    answers: int
    stamp: int
    period: int
    latency: float


@dataclass(frozen=True)
class WatchRequest(Message):
    """A watcher's wish to see what a worker flies; it holds for `WatchTerms.lease_seconds` and is then made again.

    Attributes:
        watcher: a name of its own.
        stay: False ends the watching at once.
    """

    KIND = 15
    watcher: str
    stay: bool


@dataclass(frozen=True)
class WatchTerms(Message):
    """A worker's answer to a WatchRequest.

    Attributes:
        toml: the run's configuration; with a frame's farm seed it says where the sensors stand.
        part_names: K names of the reward's parts.
        lease_seconds: how long the worker goes on publishing without another request, s.
        steps_per_second: most frames that it publishes in a second, on average over whole episodes.
    """

    KIND, MOST_HEADER = 16, MAX_HEADER
    toml: str
    part_names: tuple[str, ...]
    lease_seconds: float
    steps_per_second: float


@dataclass(frozen=True)
class ViewMessage(Message):
    """Consecutive steps of one of a worker's farms, one frame each; `common.protocol.view_checks` says what is checked.

    Attributes:
        farm: the farm's seed.
        episode: the episode's seed.
        first: step of the first frame.
        skipped: steps of this farm that were flown since somebody watches, and not shown.
        deviation: standard deviation of the exploration noise.
        uniform: whether actions were drawn uniformly instead (warm-up).
        position: [F, n, 2] m.
        assignment: [F, n_m + n_d] relay of each served UAV.
        quality: [F, n_m + n_d] signal-to-noise ratio of its link, dB.
        aoi: [F, S] as shares of AoI_max, in 255ths.
        vdf: [F, n_px, n_py] as shares of VDF_max, in 255ths.
        level: [F, 2] mean AoI and mean VDF, units.
        parts: [F, types, K] parts of the step's reward, mean over the agents of each type.
    """

    KIND = 17
    farm: int
    episode: int
    first: int
    skipped: int
    deviation: float
    uniform: bool
    position: Float32
    assignment: NDArray[np.uint8]
    quality: Float32
    aoi: NDArray[np.uint8]
    vdf: NDArray[np.uint8]
    level: Float32
    parts: Float32


@dataclass(frozen=True)
class DeliveryMessage(Message):
    """What stands before the chunks of one request; their frames follow it, one after another.

    They are numbered consecutively, the first one by the envelope's sequence number.

    Attributes:
        oldest: sequence number of the oldest chunk that the worker still holds.
        flown: environment steps that this incarnation had flown when it sent this, those in its spool included.
        sizes: bytes of each chunk's frame; at most MOST_CHUNKS of them, of together MOST_BYTES when there are several.
    """

    KIND = 18
    oldest: int
    flown: int
    sizes: tuple[int, ...]
