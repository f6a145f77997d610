"""The newest checked report of one process, and the counters from which its rates are computed."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.deploy.monitor.environment_labels import NAME_LENGTH, plotted, type_label
from eia_sec.deploy.monitor.sanitised import metrics
from eia_sec.deploy.monitor.snapshot import ImitationRow, LedgerCounts, Membership, RoundRow

RATE_SECONDS: Final = 10.0
"""Time over which rates are computed. It is long because a worker may report no chunk in a second."""
COUNTED: Final = {"learner": "updates", "rollout": "environment_steps", "flight": "decisions"}
"""What each role makes, by the name of its counter."""
TRACK: Final = 64
"""Most messages over which a rate is computed."""
COUNTERS: Final = ("environment_steps", "waiting_seconds", *COUNTED.values())
"""Metrics of which rates are shown."""
MOST_ALARMS: Final = 16
"""Most alarms of one process that are shown; the rest are counted."""
_LEDGER: Final = ("produced", "accepted", "duplicates", "rejected", "in_flight", "unexplained", "lost")
TROUBLES: Final = ("outages", "step_timeouts")
"""A worker's counts of what its environments did."""
_SHOWN: Final = frozenset((*COUNTERS, *_LEDGER, "alarms", "episodes", "queue", "spooled", "waiting_seconds", *TROUBLES))
"""The metrics of a worker or flight node that a view shows; the rest of its report is dropped."""
_OF_ELITE: Final = frozenset(("rate", "next_episode", "shared", "elites", "scores", "failures", "noise_free"))
_WHOLE: Final = "learner"
"""The role whose whole report is kept."""


@dataclass
class ProcessReport:
    """The newest report and state of one process.

    Attributes:
        values: the newest metrics that a view shows.
        message: the message that brought them, without the metrics.
        version: the parameter version that the process holds.
        at: when it came, s.
        missed: messages that did not arrive.
        alive: whether the process has a liveliness token.
        announced: whether it ever had one.
        change: when it appeared or vanished, s.
    """

    values: dict[str, Any] = field(default_factory=dict)
    message: MetricMessage | None = None
    version: int = 0
    at: float = 0.0
    missed: int = 0
    alive: bool = True
    announced: bool = False
    change: float = field(default_factory=monotonic)
    _track: deque[tuple[float, dict[str, Any]]] = field(default_factory=lambda: deque(maxlen=TRACK))

    def follow(self, role: str, message: MetricMessage, version: int, now: float) -> None:
        """Process a newer message of the process, or the first message of its next start.

        Raises:
            SchemaError: its metrics are malformed.
        """
        before, values = self.message, metrics(message.values)
        _check(values)
        values = _kept(role, values)
        if before is not None and before.pid == message.pid:
            self.missed += max(0, message.counter - before.counter - 1)
        if before is None or before.pid != message.pid or message.uptime <= before.uptime:
            self._track.clear()
        self._track.append((message.uptime, {name: values.get(name, 0) for name in COUNTERS}))
        while len(self._track) > 2 and message.uptime - self._track[0][0] > RATE_SECONDS:
            self._track.popleft()
        self.message, self.values = replace(message, values={}), values
        self.version, self.at = version, now

    def rate(self, counter: str) -> float | None:
        """Return how fast a counter grows, per second, over the last RATE_SECONDS; None before the second message."""
        if len(self._track) < 2:
            return None
        (began, first), (ended, last) = self._track[0], self._track[-1]
        return float(last[counter] - first[counter]) / (ended - began)

    def waits(self) -> float | None:
        """Return a worker's share of the last RATE_SECONDS in which it waited for the learner; None if unknown."""
        return self.rate("waiting_seconds")

    def drop(self) -> None:
        """Forget metrics that could not be shown."""
        self.values = {}
        self._track.clear()


def _kept(role: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return the metrics that a view shows of a process of this role: others take memory, and there may be many."""
    if role != _WHOLE:
        names = _SHOWN | _OF_ELITE if role == "elite" else _SHOWN
        values = {name: value for name, value in values.items() if name in names}
    alarms = values.get("alarms", [])
    if isinstance(alarms, list) and len(alarms) > MOST_ALARMS:
        values["alarms"] = [*alarms[:MOST_ALARMS], f"{len(alarms) - MOST_ALARMS} more alarms."]
    return values


def _check(values: Mapping[str, Any]) -> None:
    """Raise SchemaError, TypeError, ValueError, LookupError or AttributeError for metrics that a view cannot read."""
    for ledger in (values.get("ledger", {}), *values.get("ledgers", {}).values()):
        ledger_of(ledger)
        int(ledger.get("workers", 0))
    for event in values.get("imitations", []):
        imitation_row(event, values)
    elites_of(values, values)
    membership_of(values, "")
    for name in ("elites", "waits", "curves"):
        if not isinstance(values.get(name, {}), dict):
            raise SchemaError(f"{name} is not a map.")
    noise_free_of(values)
    for number in (*values.get("elites", {}).values(), *values.get("waits", {}).values()):
        float(number)
    plotted(values), type_label(values, "")
    for name in TROUBLES:
        int(values.get(name, 0))
    float(values.get("rate", 0)), float(values.get("next_episode", 0)), int(values.get("failures", 0))
    if not all(isinstance(text, str) for text in values.get("alarms", [])):
        raise SchemaError("an alarm is not a text.")


def noise_free_of(values: Mapping[str, Any]) -> tuple[int, float]:
    """Return the number of the coordinator's newest noise-free evaluation, 0 before the first, and its reward."""
    found = values.get("noise_free", {})
    return int(found.get("number", 0)), float(found.get("reward", 0.0))


def ledger_of(values: Mapping[str, Any]) -> LedgerCounts:
    """Return a ledger from reported metrics; what is missing is 0."""
    counts = {name: int(values.get(name, 0)) for name in _LEDGER if name != "lost"}
    lost = values.get("lost", 0)
    return LedgerCounts(**counts, lost=None if lost is None else int(lost))


def imitation_row(event: Mapping[str, Any], learner: Mapping[str, Any]) -> ImitationRow:
    """Return an imitation event as the learner reports it among its metrics."""
    return ImitationRow(
        event=int(event["event"]),
        episode=int(event["episode"]),
        rate=float(event["rate"]),
        elites=elites_of(event, learner),
    )


def membership_of(learner: Mapping[str, Any], run: str) -> Membership | None:
    """Return what a learner is inside a population, by its metrics; None for a run alone."""
    if "round" not in learner:
        return None
    values = learner.get("hyperparameters", {})
    return Membership(
        round=int(learner["round"]),
        hyperparameters=tuple((str(name)[:NAME_LENGTH], float(value)) for name, value in values.items()),
        newest=tuple(_round_row(event, learner, run) for event in learner.get("exploits", [])),
    )


def _round_row(event: Mapping[str, Any], learner: Mapping[str, Any], run: str) -> RoundRow:
    scores = {str(name): float(score) for name, score in event["scores"].items()}
    score = scores.get(run)
    sources = event["sources"].items()
    return RoundRow(
        round=int(event["round"]),
        score=score,
        rank=None if score is None else 1 + sum(other > score for other in scores.values()),
        members=len(scores),
        rate=float(event["rate"]),
        sources=tuple((type_label(learner, kind), str(source)[:NAME_LENGTH]) for kind, source in sources),
    )


def elites_of(values: Mapping[str, Any], learner: Mapping[str, Any]) -> tuple[tuple[str, int, float | None], ...]:
    """Return each type's name, elite and its score, of an imitation event or of the coordinator's report."""
    scores = values.get("scores", {})
    return tuple(
        (type_label(learner, kind), int(elite), _score(scores.get(kind), int(elite)))
        for kind, elite in values.get("elites", {}).items()
    )


def _score(scores: Any, elite: int) -> float | None:
    """Return an elite's score, None where none or no finite one was reported."""
    return None if scores is None or scores[elite] is None else float(scores[elite])
