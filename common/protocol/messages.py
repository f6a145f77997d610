"""Every message type of the protocol, one dataclass each; `keys` lists their keys, `codec` encodes them."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.population import Exploit
from eia_sec.common.protocol.bfloat16 import Bits
from eia_sec.common.protocol.codec import NO_LIMIT, Message
from eia_sec.common.protocol.frame import MAX_HEADER
from eia_sec.common.team import Float32


@dataclass(frozen=True)
class Envelope(Message):
    """Who sent a payload; travels as its attachment.

    Attributes:
        role, name: rollout, learner, elite, flight or vehicle, and the sender's name, unique inside its role.
        incarnation: number of the start; each start of a process of this name has a greater one.
        sequence: number on this key, from 1; of a request, that of its first chunk. The coordinator always sends 1.
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
    """Rows of transitions and the K episodes that ended in them; travels inside a delivery.

    Attributes:
        team: digest of the team layout.
        version: parameter version of the actors that produced the rows.
        produced: environment steps that this incarnation has produced, this chunk included.
        observation, action, reward, flag: the rows, see `eia_sec.common.transitions.Rows`.
        log_probability, state: likewise; for None, [R, 0] and left out.
        farm, episode, steps: [K] int64, farm seed, episode seed and length of each finished episode.
        episode_reward: [K, agents] float32.
        episode_metrics, metric_names: [K, F] float64, the environment's episode metrics, and their names.
        infos, info_names: [K, I] float64, means of the numbers in infos, NaN where an episode has none, and their
            names; left out where there are none.
    """

    KIND = 2
    team: str
    version: int
    produced: int
    observation: Float32 | Bits | NDArray[np.uint8]
    action: Float32
    reward: Float32
    flag: NDArray[np.uint8]
    log_probability: Float32
    farm: NDArray[np.int64]
    episode: NDArray[np.int64]
    steps: NDArray[np.int64]
    episode_reward: Float32
    episode_metrics: NDArray[np.float64]
    metric_names: tuple[str, ...]
    state: Float32 | None = None
    infos: NDArray[np.float64] | None = None
    info_names: tuple[str, ...] | None = None


@dataclass(frozen=True)
class ChunkAck(Message):
    """The learner's answer to a delivery: one verdict for each chunk, up to the first that it did not settle.

    Attributes:
        verdicts: accepted, duplicate or refused; the last may be gap, damaged (send it again), closed (the learner
            takes no more) or replaced (a newer start of the worker delivers). Later chunks were not examined.
        reasons: for each verdict, why the chunk was not accepted, or empty.
        expected: sequence number of the next chunk that the learner accepts from this worker.
        required_version: parameter version that the worker must hold before its next chunk; 0 for none.
        window, asked_steps: as in ProgressMessage, at the time of the answer.
    """

    KIND = 3
    verdicts: tuple[str, ...]
    reasons: tuple[str, ...]
    expected: int
    required_version: int
    window: int = NO_LIMIT
    asked_steps: int = NO_LIMIT


@dataclass(frozen=True)
class ParametersMessage(Message):
    """The parameters of all actors, at one version.

    Attributes:
        epoch: the learner's fencing epoch; parameters of a lower one are not applied while a higher one is alive.
        version: grows with every publication.
        event: number of imitation events already applied to these parameters.
        environment_steps: environment steps that the learner had accepted.
        progress: share of the run's episodes that are finished, 0..1.
        team: digest of the team layout.
        hidden: width of the hidden layers.
        head: kind of the last layer, deterministic or gaussian.
        flat: for each type, [n_v, P_v] float32, or [1, P_v] where agents share them, see `eia_sec.common.actors`.
        memory: kind of memory, see `eia_sec.common.gru`; left out for actors without memory.
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
    memory: str | None = None


@dataclass(frozen=True)
class ProgressMessage(Message):
    """The learner's progress; small and sent often.

    Attributes:
        epoch: the learner's fencing epoch.
        version, events: newest published parameter version, and imitation events applied.
        episodes, environment_steps, updates: training episodes finished, environment steps accepted, updates done.
        state: training, draining or finished.
        window: environment steps that a worker may have under way, NO_LIMIT where nothing limits them. A worker that
            has as many waits, because the learner would get what it flew too late (on policy).
        asked_steps: environment steps that a worker's next chunk should have, if fewer than the configuration says,
            because several share an iteration.
        arguments: those that environments have from their next episodes on, a JSON object; empty for the configured
            ones. A learner that resumes has those of its checkpoint.
        separate_since: as in the trainer, episodes that were finished when agents got actors of their own; None
            while they share them.
        round: newest round of a population that it took part in; left out of a run alone, as is the next.
        hyperparameters: with which a member of a population now learns.
        reward_steps, reward_sums: of agents' rewards in training, see `eia_sec.common.reward_sums`; no sums before the
            first step.
    """

    KIND = 5
    epoch: int
    version: int
    events: int
    episodes: int
    environment_steps: int
    updates: int
    state: str
    window: int = NO_LIMIT
    asked_steps: int = NO_LIMIT
    arguments: str = ""
    separate_since: int | None = None
    reward_steps: float = 0.0
    reward_sums: NDArray[np.float64] | None = None
    round: int | None = None
    hyperparameters: dict[str, Any] | None = None


@dataclass(frozen=True)
class CommandMessage(Message):
    """A command for the learner; its key ends in one of `eia_sec.common.protocol.keys.VERBS`.

    Attributes:
        sender: name of the asking process.
        arguments: with the verb arguments, those that environments have from their next episodes on, a JSON object;
            else left out.
    """

    KIND = 6
    sender: str
    arguments: str | None = None


@dataclass(frozen=True)
class ConfigurationMessage(Message):
    """What a process needs to join the run.

    Attributes:
        epoch: the learner's fencing epoch.
        toml: the run's configuration.
        team: the team's layout, see `eia_sec.common.team.TeamSpec.to_dict`.
        lockstep: whether worker and learner take turns.
        newest_incarnation: number beyond which a new start of the asking worker goes: the greatest that the learner
            knows of it, or the learner's clock.
    """

    KIND, MOST_HEADER = 7, MAX_HEADER
    epoch: int
    toml: str
    team: dict[str, Any]
    lockstep: bool
    newest_incarnation: int = 0


@dataclass(frozen=True)
class ReceiptMessage(Message):
    """Whether a request was granted; `reason` explains a refusal or a repeated request, else it is empty."""

    KIND = 8
    done: bool
    reason: str


@dataclass(frozen=True)
class EvaluationOrder(Message):
    """A request for noise-free evaluation episodes.

    Attributes:
        epoch: the learner's fencing epoch.
        event: number of the imitation event, or the round of a population, that needs them.
        version: lowest parameter version with which the worker may fly them; with `flat`, the version of those.
        farms, episodes: farm and episode seeds, one of both for each episode.
        flat: for each type, the actors to evaluate, as in ParametersMessage; left out for those that the worker has.
    """

    KIND = 9
    epoch: int
    event: int
    version: int
    farms: tuple[int, ...]
    episodes: tuple[int, ...]
    flat: tuple[Float32, ...] | None = None


@dataclass(frozen=True)
class EvaluationResult(Message):
    """The step rewards of F noise-free episodes.

    Attributes:
        event, version: number of the imitation event that needs them, and parameter version that was evaluated.
        reward: [F, T, agents] float32 step rewards R_v-i; zeros after the end of a shorter episode.
        steps: [F] int64 length of each episode, at most T.
    """

    KIND = 10
    event: int
    version: int
    reward: Float32
    steps: NDArray[np.int64]


@dataclass(frozen=True)
class ImitationMessage(Message):
    """One imitation event (see `eia_sec.common.imitation.ImitationEvent`) and the epoch of the learner that it is for.

    Attributes:
        epoch: the learner's fencing epoch.
        event: number e of the event, from 1.
        version: parameter version that was evaluated.
        episode: training episode at which it was due.
        rate: vartheta, the share by which actors move towards the elite.
        elites: for each type, the index of its elite agent.
        scores: for each type, omega of each of its agents.
        evaluation_steps: environment steps that its evaluation took.
    """

    KIND, MOST_HEADER = 11, 1024 * 1024
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
        """Return the event, not yet checked against a team."""
        return ImitationEvent(**{name: value for name, value in vars(self).items() if name != "epoch"})


@dataclass(frozen=True)
class ExploitMessage(Message):
    """What a round of a population means for one member (see `eia_sec.common.population.Exploit`).

    Attributes:
        epoch: the fencing epoch of the learner that it is for.
        round: number of the round, from 1.
        rate: share by which its actors move to those of `flat`.
        scores: of each member that took part, by its run's name.
        sources: for each type, the member whose team it imitates, or empty for none.
        flat: for each type, the actors to imitate, [n_v, P_v] or [1, P_v]; [0, 0] for none.
        hyperparameters: with which it goes on.
        evaluation_steps: environment steps that its evaluation took.
    """

    KIND = 20
    epoch: int
    round: int
    rate: float
    scores: dict[str, Any]
    sources: tuple[str, ...]
    flat: tuple[Float32, ...]
    hyperparameters: dict[str, Any]
    evaluation_steps: int

    @classmethod
    def of(cls, event: Exploit, epoch: int) -> "ExploitMessage":
        """Return the message of a round."""
        maps = {name: dict(getattr(event, name)) for name in ("scores", "hyperparameters")}
        return cls(epoch=epoch, **{**vars(event), **maps})

    def to_event(self) -> Exploit:
        """Return the round, not yet checked against a team and a configuration."""
        return Exploit(**{name: value for name, value in vars(self).items() if name != "epoch"})


@dataclass(frozen=True)
class MetricMessage(Message):
    """One process's metrics; may be lost.

    Attributes:
        counter: grows by one with each message, so gaps show.
        host: the machine's name.
        pid: process id.
        uptime: seconds since the process joined the run.
        values: metrics by name, see `eia_sec.common.protocol.metrics`; numbers, strings, and lists and maps of them.
    """

    KIND, MOST_HEADER = 12, 256 * 1024
    counter: int
    host: str
    pid: int
    uptime: float
    values: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PoseMessage(Message):
    """Where one vehicle is and what it has served; its envelope has the role `vehicle` and a growing sequence number.

    Attributes:
        agent: the agent that it flies as, for instance communication_0.
        stamp: time of the pose, microseconds since 1970 by the vehicle's clock.
        place: x and y in the field, m; or latitude and longitude, degrees.
        geodetic: whether `place` is in degrees.
        height: above the field, m.
        velocity: over ground along x and y of the field, m/s.
        acceleration: likewise, m/s^2; empty if the vehicle does not know it.
        commanded: velocity along x and y that it is flown to now, m/s; empty if it does not know it.
        charge: of its battery, J; None if it does not know it.
        wind: along x and y, m/s; empty if it does not know it.
        lost: whether it is out of service for good.
        decision: number of the decision that it flies or has flown; 0 before the first.
        node, node_start: name and incarnation of the flight node that it obeys; empty and 0 for none.
        rival: another flight node, whose set-points it has refused of late; or empty.
        served: [k] int32 what it served in the last seconds: a monitoring UAV the plots that it photographed, numbered
            column by column from the field's corner; a data collection UAV the sensors whose packets it acknowledged.
        served_stamp: [k] int64 when, microseconds since 1970 by its clock.
    """

    KIND = 13
    agent: str
    stamp: int
    place: tuple[float, ...]
    geodetic: bool
    height: float
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    commanded: tuple[float, ...]
    charge: float | None
    wind: tuple[float, ...]
    lost: bool
    decision: int
    node: str
    node_start: int
    rival: str
    served: NDArray[np.int32]
    served_stamp: NDArray[np.int64]


@dataclass(frozen=True)
class SetpointMessage(Message):
    """A command for one vehicle.

    Attributes:
        agent: the agent that decided.
        velocity: to fly along x and y of the field, m/s; zeros with hover.
        target: x and y that it leads to in a step of the farm, inside the field, m; with hover where the vehicle was,
            or empty if nobody knows.
        height: to fly at, m.
        yaw: of the vehicle's nose, counter-clockwise from the field's x axis, radians.
        action: the decision itself as shares of top speed; the field's border may limit `velocity` to less.
        hover: whether the watchdog commands hover.
        reason: why it does, or empty.
        decision: number of the decision, one more in each step of the farm, from 1; 0 with hover.
        period: number of the flight node's period, counted from 1.
        validity: seconds for which the vehicle may follow it; then it hovers by itself.
        stamp: stamp of the vehicle's newest pose; 0 if there is none.
        latency: seconds from receiving that pose to sending this message; 0 if there is none.
        vehicle_start: incarnation of the vehicle that told that pose; 0 if there is none.
    """

    KIND = 14
    agent: str
    velocity: tuple[float, ...]
    target: tuple[float, ...]
    height: float
    yaw: float
    action: tuple[float, ...]
    hover: bool
    reason: str
    decision: int
    period: int
    validity: float
    stamp: int
    latency: float
    vehicle_start: int


@dataclass(frozen=True)
class WatchRequest(Message):
    """A watcher's request for frames of a worker's farm; it holds for `WatchTerms.lease_seconds`, then it is renewed.

    Attributes:
        watcher: the watcher's name, unique among watchers.
        stay: False ends the watching at once.
    """

    KIND = 15
    watcher: str
    stay: bool


@dataclass(frozen=True)
class WatchTerms(Message):
    """A worker's answer to a WatchRequest.

    Attributes:
        toml: the run's configuration; it and a frame's farm seed determine the sensors' positions.
        part_names: names of the reward's K parts; empty if the environment is no farm.
        lease_seconds: how long the worker publishes after a request, s.
        steps_per_second: most frames that it publishes per second, averaged over whole episodes.
        agents: names of the agents in row order; empty for a farm.
        team: layout of a row, as in ConfigurationMessage; left out for a farm, whose configuration determines it.
    """

    KIND, MOST_HEADER = 16, MAX_HEADER
    toml: str
    part_names: tuple[str, ...]
    lease_seconds: float
    steps_per_second: float
    agents: tuple[str, ...] = ()
    team: dict[str, Any] | None = None


@dataclass(frozen=True)
class ViewMessage(Message):
    """Consecutive steps of one of a worker's farms, one frame each; checked by `eia_sec.common.protocol.view_checks`.

    Attributes:
        farm: the farm's seed.
        episode: the episode's seed.
        first: step of the first frame.
        skipped: steps of this farm, flown while somebody watched, that were not published.
        noise_std: standard deviation of the exploration noise, or epsilon where options are chosen by value.
        uniform: whether actions were drawn uniformly instead (warm-up).
        position: [F, n, 2] m.
        assignment: [F, n_m + n_d] relay of each served UAV; 255 for none.
        quality: [F, n_m + n_d] signal-to-noise ratio of each served UAV's link, dB.
        aoi: [F, S] AoI of each sensor over AoI_max, in 255ths.
        vdf: [F, n_px, n_py] VDF of each plot over VDF_max, in 255ths.
        level: [F, 2] mean AoI and mean VDF, units.
        parts: [F, types, K] parts of the step reward, averaged over the agents of each type.
        gone: [F, n] 1 for UAVs that have failed, are missing or have no charge; left out where none can.
        charge: [F, n] charge over capacity, in 255ths; left out without batteries.
        known: [F, P] 1 for patches of stress that the team knows; left out without patches.
    """

    KIND = 17
    farm: int
    episode: int
    first: int
    skipped: int
    noise_std: float
    uniform: bool
    position: Float32
    assignment: NDArray[np.uint8]
    quality: Float32
    aoi: NDArray[np.uint8]
    vdf: NDArray[np.uint8]
    level: Float32
    parts: Float32
    gone: NDArray[np.uint8] | None = None
    charge: NDArray[np.uint8] | None = None
    known: NDArray[np.uint8] | None = None

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.position)


@dataclass(frozen=True)
class StepsMessage(Message):
    """Consecutive steps of a worker's first environment, where that is no farm; checked by `view_checks`, too.

    Attributes:
        scenario: the scenario's seed.
        episode: the episode's seed.
        first: step of the first frame; 0 is the state after the reset.
        skipped: steps of this environment, done while somebody watched, that were not published.
        noise_std: standard deviation of the exploration noise, or epsilon where options are chosen by value.
        uniform: whether actions were drawn uniformly instead (warm-up).
        reward: [F, agents] rewards of each step.
        action: [F, A] actions that led to each frame, in the environment's units, or indices of options; 0 in step 0.
        seen: [F, agents, 3] least, mean and largest number of each agent's observation.
        alive: [F, agents] 1 for agents that take part after the step.
        pictures: [B] what `render()` shows after some of the steps, PNG files one after another.
        ends: [F] where in `pictures` each frame's picture ends; a frame without one ends where the last one did.
        silence: why there are no pictures, a sentence; empty where there are, or may still come.
    """

    KIND = 19
    scenario: int
    episode: int
    first: int
    skipped: int
    noise_std: float
    uniform: bool
    reward: Float32
    action: Float32
    seen: Float32
    alive: NDArray[np.uint8]
    pictures: NDArray[np.uint8]
    ends: NDArray[np.int64]
    silence: str

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.ends)


@dataclass(frozen=True)
class DeliveryMessage(Message):
    """The first frame of a transition request; its chunks' frames follow, numbered from the envelope's number on.

    Attributes:
        oldest: sequence number of the oldest chunk that the worker still holds.
        flown: environment steps in whole chunks that this incarnation had simulated by then, its spool included.
        sizes: bytes of each chunk's frame; see `eia_sec.common.protocol.chunk_messages` for how many and how large.
    """

    KIND = 18
    oldest: int
    flown: int
    sizes: tuple[int, ...]
