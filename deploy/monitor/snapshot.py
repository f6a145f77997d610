"""What is known of a run at one moment, for the live view and for `eia-sec monitor --json`.

Everything is plain data. What is not known yet is None.
"""

import math
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Final

SMOOTHING: Final = 20
"""Newest values whose mean counts as a series' latest."""
QUIET_SECONDS: Final = 5.0
"""Age of a process's last message from which on it is marked, s."""


@dataclass(frozen=True)
class Series:
    """One figure over time.

    Attributes:
        name: what it is called in the view.
        values: oldest first, one for each episode or report.
        digits: decimals that are shown.
    """

    name: str
    values: tuple[float, ...] = ()
    digits: int = 1

    @property
    def latest(self) -> float | None:
        """Mean of the newest SMOOTHING values, or None when there is none."""
        newest = self.values[-SMOOTHING:]
        return sum(newest) / len(newest) if newest else None


@dataclass(frozen=True)
class Ledger:
    """Where produced environment steps are: produced = accepted + lost + rejected + in flight, if all are explained.

    Attributes:
        produced: environment steps that were flown.
        accepted: environment steps that the learner has taken in.
        rejected: environment steps in chunks that it refused.
        lost: environment steps that are declared lost; unknown where only a worker's own account is known.
        in_flight: environment steps that were flown and have neither arrived nor been given up.
        unexplained: environment steps by which that fails, and accepted ones that are neither in replay nor on the way
            to it; 0 but for a defect.
        duplicates: chunks that came again and were not taken in.
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
        elites: for each type, its name and the newest elite's index inside it.
        newest: the newest events, oldest first.
    """

    events: int = 0
    rate: float | None = None
    next_episode: int | None = None
    elites: tuple[tuple[str, int], ...] = ()
    newest: tuple[ImitationRow, ...] = ()


@dataclass(frozen=True)
class ProcessRow:
    """One process of the fleet.

    Attributes:
        role: learner, elite, rollout or flight.
        name: its name inside the role.
        host: the machine's name.
        pid: its process number.
        uptime: seconds since its start.
        rate: environment steps, updates or decisions per second, whatever the role makes, over the last seconds.
        version: parameter version that it holds.
        behind: versions by which that is older than the learner's newest.
        episodes: episodes that it finished.
        queue: chunks that wait in it.
        age: seconds since its last message.
        alive: whether its liveliness token stands.
        ledger: where the steps of a worker are, over all its starts.
        trouble: whether it is gone, silent, far behind or slow; alarms that it tells of itself do not count.
        left: whether it is known from the learner's ledger alone: a worker that was there before this view looked.
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
    ledger: Ledger | None = None
    trouble: bool = False
    left: bool = False

    @property
    def quiet(self) -> bool:
        """Whether it is gone or has said nothing for QUIET_SECONDS; one that has left long ago is no news."""
        return not self.left and (not self.alive or self.age >= QUIET_SECONDS)


@dataclass(frozen=True)
class Snapshot:
    """Everything that the view shows, at one moment.

    Attributes:
        run: the run's name.
        state: starting, training, draining or finished.
        elapsed: seconds since the start.
        left: estimated seconds to the end.
        episodes: training episodes finished.
        episodes_total: training episodes of the whole run, lambda_max.
        reward: mean reward per agent, first over all agents, then for each type.
        freshness: AoI and VDF, units, or the length of episodes where there are none.
        steps: environment steps accepted.
        steps_rate: the same per second.
        updates: update rounds done.
        updates_rate: the same per second.
        staleness: parameter versions by which the newest chunks' policies were older than the learner's, running mean.
        learner_wait: share of the time since its start in which the learner waits for data, 0..1.
        worker_wait: mean share of time in which the workers wait for the learner, 0..1.
        ledger: where the produced steps of the run are.
        others: how many workers the learner sums in its account, and where their steps are.
        imitation: the elite imitation so far.
        processes: one row for each process.
        alarms: sentences that somebody should read.
    """

    run: str
    state: str = "starting"
    elapsed: float = 0.0
    left: float | None = None
    episodes: int = 0
    episodes_total: int = 0
    reward: tuple[Series, ...] = ()
    freshness: tuple[Series, ...] = ()
    steps: int = 0
    steps_rate: float | None = None
    updates: int = 0
    updates_rate: float | None = None
    staleness: float | None = None
    learner_wait: float | None = None
    worker_wait: float | None = None
    ledger: Ledger = field(default_factory=Ledger)
    others: tuple[int, Ledger] | None = None
    imitation: Imitation = field(default_factory=Imitation)
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
