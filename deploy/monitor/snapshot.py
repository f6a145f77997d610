"""The state of a run at one moment, for the live view and `eia-sec monitor --json`.

Everything is plain data. Unknown values are None.
"""

import math
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Final

SMOOTHING: Final = 20
"""Number of newest values whose mean is a series' latest value."""
QUIET_SECONDS: Final = 5.0
"""Age of a process's last message from which it is marked as quiet, s."""


@dataclass(frozen=True)
class Series:
    """One metric over time.

    Attributes:
        name: its label in the view.
        values: oldest first, one for each episode or report.
        digits: number of decimals.
        smoothing: how many of the newest values the latest one is the mean of.
    """

    name: str
    values: tuple[float, ...] = ()
    digits: int = 1
    smoothing: int = SMOOTHING

    @property
    def latest(self) -> float | None:
        """Mean of the newest values, or None when there is none."""
        newest = self.values[-self.smoothing :]
        return sum(newest) / len(newest) if newest else None


@dataclass(frozen=True)
class LedgerCounts:
    """Where the produced environment steps are: produced = accepted + lost + rejected + in flight + unexplained.

    Attributes:
        produced: environment steps that were simulated.
        accepted: environment steps that the learner has accepted.
        rejected: environment steps in chunks that it refused.
        lost: environment steps that are declared lost; unknown if only a worker's own count is known.
        in_flight: environment steps that were simulated and have neither arrived nor been given up.
        unexplained: environment steps by which that fails, and accepted ones that are neither in replay nor on the way
            to it; 0 but for a defect.
        duplicates: chunks that arrived again and were not accepted again.
    """

    produced: int = 0
    accepted: int = 0
    duplicates: int = 0
    rejected: int = 0
    lost: int | None = 0
    in_flight: int = 0
    unexplained: int = 0


@dataclass(frozen=True)
class ImitationRow:
    """One imitation event that the learner has applied.

    Attributes:
        event: its number.
        episode: the episode at which it was due.
        rate: vartheta, the share by which actors moved towards the elite, 0..1.
        elites: for each type, its name, the elite's index inside it, and the elite's score omega.
    """

    event: int
    episode: int
    rate: float
    elites: tuple[tuple[str, int, float | None], ...] = ()


@dataclass(frozen=True)
class Imitation:
    """The elite imitation so far.

    Attributes:
        events: number of events applied.
        rate: vartheta of the newest event.
        next_episode: the episode at which the next event falls due.
        shared: whether the agents of a type still share their actors, so that none imitates.
        elites: for each type, its name, and the index and score omega of the agent that now scores best.
        newest: the newest events, oldest first.
    """

    events: int = 0
    rate: float | None = None
    next_episode: int | None = None
    shared: bool = False
    elites: tuple[tuple[str, int, float | None], ...] = ()
    newest: tuple[ImitationRow, ...] = ()

    @property
    def happens(self) -> bool:
        """Whether agents have imitated or will: no elite is looked for while they share actors, or in other runs."""
        return self.events > 0 or (self.next_episode is not None and not self.shared)


@dataclass(frozen=True)
class RoundRow:
    """One round of a population in which the learner took part.

    Attributes:
        round: its number.
        score: of this member, omega.
        rank: of this member by its score, 1 for the best.
        members: how many took part.
        rate: share by which its actors moved to those that they imitated; 0 where none did.
        sources: types that imitated, and the member whose team each imitated.
    """

    round: int
    score: float | None
    rank: int | None
    members: int
    rate: float
    sources: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Membership:
    """What a learner is inside a population.

    Attributes:
        round: the newest round in which it took part.
        hyperparameters: names and present values of those in which members differ.
        newest: the newest rounds, oldest first.
    """

    round: int
    hyperparameters: tuple[tuple[str, float], ...] = ()
    newest: tuple[RoundRow, ...] = ()


@dataclass(frozen=True)
class ProcessRow:
    """One process of the run.

    Attributes:
        role: learner, elite, rollout or flight.
        name: its name inside the role.
        host: the machine's name.
        pid: its process id.
        uptime: seconds since its start.
        rate: environment steps, updates or decisions per second, depending on the role, over the last seconds.
        version: its parameter version.
        behind: how many versions it lags behind the learner.
        episodes: episodes that it finished.
        queue: chunks that wait in its queue.
        age: seconds since its last message.
        alive: whether it has a liveliness token.
        ledger: a worker's steps, over all its starts.
        trouble: whether it is gone, silent, far behind or slow; its own alarms do not count.
        left: whether it left as intended: the run is over, or it is a worker that left before this view started, which
            only the learner's ledger knows.
        waits: a worker's share of the last seconds in which it waited for the learner, 0..1; None if unknown.
    """

    role: str
    name: str
    host: str
    pid: int
    uptime: float
    rate: float | None = None
    version: int | None = None
    behind: int | None = None
    episodes: int | None = None
    queue: int | None = None
    age: float = 0.0
    alive: bool = True
    ledger: LedgerCounts | None = None
    trouble: bool = False
    left: bool = False
    waits: float | None = None

    @property
    def quiet(self) -> bool:
        """Whether it is gone or has been silent for QUIET_SECONDS; workers that left long ago do not count."""
        return not self.left and (not self.alive or self.age >= QUIET_SECONDS)


@dataclass(frozen=True)
class Snapshot:
    """Everything that a view shows, at one moment.

    Attributes:
        run: the run's name.
        state: starting, training, draining or finished.
        elapsed: seconds since the start.
        left: estimated seconds to the end.
        episodes: training episodes finished.
        episodes_total: training episodes of the whole run, lambda_max; 0 where steps end it.
        steps_total: training steps of the whole run; 0 where episodes end it.
        progress: finished share of the run, 0..1.
        reward: mean reward per agent, first over all agents, then for each type.
        noise_free: what the actors earn per agent without noise, by small evaluations during the run; empty before the
            first, and outside the farm.
        freshness: AoI and VDF, units, or the length of episodes where there are none.
        steps: environment steps accepted.
        steps_rate: the same per second.
        updates: number of updates.
        updates_rate: the same per second.
        staleness: parameter versions by which the newest chunks' policies were older than the learner's, running mean.
        learner_wait: share of its time that the learner waits for data, 0..1.
        worker_wait: mean share of their time that workers wait for the learner, 0..1.
        ledger: the run's steps.
        others: the number of workers that the learner reports as a sum, and their steps.
        outages: times that environments of the workers' present starts went away.
        step_timeouts: times that workers were ended and replaced because of `env.step_timeout`.
        imitation: the elite imitation so far.
        population: what the learner is inside a population; None for a run alone.
        processes: one row for each process.
        alarms: one sentence each.
    """

    run: str
    state: str = "starting"
    elapsed: float = 0.0
    left: float | None = None
    episodes: int = 0
    episodes_total: int = 0
    steps_total: int = 0
    progress: float = 0.0
    reward: tuple[Series, ...] = ()
    noise_free: Series = Series("without noise")
    freshness: tuple[Series, ...] = ()
    steps: int = 0
    steps_rate: float | None = None
    updates: int = 0
    updates_rate: float | None = None
    staleness: float | None = None
    learner_wait: float | None = None
    worker_wait: float | None = None
    ledger: LedgerCounts = field(default_factory=LedgerCounts)
    others: tuple[int, LedgerCounts] | None = None
    outages: int = 0
    step_timeouts: int = 0
    imitation: Imitation = field(default_factory=Imitation)
    population: Membership | None = None
    processes: tuple[ProcessRow, ...] = ()
    alarms: tuple[str, ...] = ()


def record(snapshot: Snapshot) -> dict[str, Any]:
    """Return a snapshot as `eia-sec monitor --json` prints it: `docs/reference/monitoring.md` lists the fields.

    A series is its name and its latest value; a number that is not finite is null.
    """
    found = _plain(snapshot)
    assert isinstance(found, dict)
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Series):
        return {"name": value.name, "latest": _plain(value.latest)}
    if is_dataclass(value):
        return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
