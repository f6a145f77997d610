"""The fleet as a plain subscriber sees it: metric messages and liveliness tokens, put together into a snapshot."""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from common.errors import ProtocolError, SchemaError
from common.protocol import keys
from common.protocol.messages import Envelope, MetricMessage
from common.team import LETTERS
from common.transport.bus import Bus
from deploy.monitor.alarms import examine
from deploy.monitor.sanitised import figures, plain
from deploy.monitor.snapshot import Imitation, ImitationRow, Ledger, ProcessRow, Series, Snapshot
from learner.intake.ledger import OTHERS

HISTORY: Final = 240
"""Points of a curve that are kept."""
RATE_SECONDS: Final = 10.0
"""Time over which rates are taken: a worker reports chunks, and one second may hold none."""
COUNTED: Final = {"learner": "updates", "rollout": "environment_steps", "flight": "decisions"}
"""What each role makes, by the name of its counter."""
TRACK: Final = 64
"""Most messages over which a rate is taken."""
COUNTERS: Final = ("environment_steps", *COUNTED.values())
"""Figures of which rates are told."""
MOST_ALARMS: Final = 16
"""Most alarms of one process that are shown; how many more there are is said."""
GONE_SECONDS: Final = 30.0
"""A process without a token stays in the table for this long."""
MOST_ROWS: Final = 4096
"""Most processes that are followed; messages of further ones are counted among those that could not be read."""
MOST_CURVES: Final = 64
"""Most types of agent whose reward is followed."""
UNREADABLE: Final = (ProtocolError, TypeError, ValueError, LookupError, AttributeError, OverflowError)
"""What becomes of figures that are none, whoever tells them."""
FRESHNESS: Final = {"aoi": "AoI", "vdf": "VDF"}
LENGTH: Final = {"steps": "episode steps"}
"""What is shown in place of AoI and VDF where there are none."""
NAME: Final = 14
"""Most characters of a type's name."""


@dataclass
class _Seen:
    values: dict[str, Any] = field(default_factory=dict)
    message: MetricMessage | None = None
    version: int = 0
    at: float = 0.0
    missed: int = 0
    alive: bool = True
    announced: bool = False
    change: float = field(default_factory=time.monotonic)
    track: deque[tuple[float, dict[str, Any]]] = field(default_factory=lambda: deque(maxlen=TRACK))

    def follow(self, message: MetricMessage, version: int, now: float) -> None:
        """Take in a newer message of the same process, or the first one of its next start.

        Raises:
            SchemaError: its figures are none.
        """
        before, values = self.message, figures(message.values)
        _check(values)
        if before is not None and before.pid == message.pid:
            self.missed += max(0, message.counter - before.counter - 1)
        if before is None or before.pid != message.pid or message.uptime <= before.uptime:
            self.track.clear()
        self.track.append((message.uptime, {name: values.get(name, 0) for name in COUNTERS}))
        while len(self.track) > 2 and message.uptime - self.track[0][0] > RATE_SECONDS:
            self.track.popleft()
        self.message, self.values = replace(message, values={}), values
        self.version, self.at = version, now

    def rate(self, counter: str) -> float | None:
        """Return how fast a counter grows, per second, over the last RATE_SECONDS; None before the second message."""
        if len(self.track) < 2:
            return None
        (began, first), (ended, last) = self.track[0], self.track[-1]
        return float(last[counter] - first[counter]) / (ended - began)


class Fleet:
    """Everything that one run's processes say of themselves.

    Args:
        bus: the control lane; only subscriptions are made on it.
        run: the run's name.
    """

    def __init__(self, bus: Bus, run: str) -> None:
        self._run = run
        self._metrics = bus.subscribe(keys.METRIC.pattern(run), 4096)
        self._tokens = bus.watch(keys.LIVE.pattern(run), 4096)
        self._seen: dict[tuple[str, str], _Seen] = {}
        self._rewards: dict[str, deque[float]] = {}
        self._figures: dict[str, deque[float]] = {}
        self._malformed = 0

    def update(self) -> None:
        """Take in what has arrived."""
        now = time.monotonic()
        for sample in self._tokens.drain():
            try:
                variables = keys.parse(sample.key).variables
                seen = self._of_name((variables["role"], variables["name"]))
                seen.alive, seen.announced, seen.change = sample.present, True, now
            except (ProtocolError, KeyError):
                self._malformed += 1
        for sample in self._metrics.drain():
            try:
                parsed = keys.parse(sample.key)
                sender, message = Envelope.decode(sample.attachment), MetricMessage.decode(sample.payload)
                if (sender.role, sender.name) != (parsed.variables["role"], parsed.variables["name"]):
                    raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}.")
                self._take((parsed.variables["role"], parsed.variables["name"]), sender, message, now)
            except UNREADABLE:
                self._malformed += 1
        for name, seen in list(self._seen.items()):
            # Whoever never had a token has no end but its silence.
            gone = now - seen.change if not seen.alive else 0.0 if seen.announced else now - seen.at
            if gone > GONE_SECONDS:
                del self._seen[name]

    def _of_name(self, name: tuple[str, str]) -> _Seen:
        if name not in self._seen and len(self._seen) >= MOST_ROWS:
            raise ProtocolError(f"there are {MOST_ROWS} processes already.")
        return self._seen.setdefault(name, _Seen())

    def _take(self, name: tuple[str, str], sender: Envelope, message: MetricMessage, now: float) -> None:
        seen = self._of_name(name)
        seen.follow(message, sender.version, now)
        if name[0] == "learner" and seen.values.get("curves"):
            curves = seen.values["curves"]
            others = {kind: curves[kind] for kind in (*FRESHNESS, *LENGTH) if kind in curves}
            for part, values in ((self._rewards, curves.get("reward", {})), (self._figures, others)):
                for kind, value in values.items():
                    if kind not in part and len(part) >= MOST_CURVES:
                        raise SchemaError(f"there are more than {MOST_CURVES} curves.")
                    part.setdefault(kind, deque(maxlen=HISTORY)).append(float(value))

    def snapshot(self, alarms: tuple[str, ...] = ()) -> Snapshot:
        """Return the present state for `deploy.monitor.live_view.render`, with the caller's alarms before its own."""
        try:
            return self._snapshot(alarms)
        except UNREADABLE:
            # Somebody's figures are not figures: without them the view goes on.
            self._malformed += 1
            for seen in self._seen.values():
                seen.values = {}
                seen.track.clear()
            return self._snapshot(alarms)

    def _snapshot(self, alarms: tuple[str, ...]) -> Snapshot:
        values = self.learner_values()
        elapsed = float(values.get("elapsed", 0.0))
        episodes, total = int(values.get("episodes", 0)), int(values.get("episodes_total", 0))
        ledgers, learner = values.get("ledgers", {}), self._of("learner")
        rows = tuple(self._row(name, seen, values, ledgers) for name, seen in sorted(self._seen.items()))
        before = sorted(name for name in ledgers if name != OTHERS and ("rollout", str(name)) not in self._seen)
        rows += tuple(
            ProcessRow("rollout", str(name), "-", 0, 0.0, alive=False, ledger=_ledger(ledgers[name]), left=True)
            for name in before
        )
        over = values.get("state") in ("draining", "finished") or 0 < total <= episodes
        rows, complaints = examine(rows, training=values.get("state") == "training" and not over, over=over)
        return Snapshot(
            run=self._run,
            state=str(values.get("state", "starting")),
            elapsed=elapsed,
            left=elapsed * (total - episodes) / episodes if episodes else None,
            episodes=episodes,
            episodes_total=total,
            reward=tuple(
                Series(LETTERS.get(kind, kind)[:NAME], tuple(points), _digits(points))
                for kind, points in self._rewards.items()
            ),
            freshness=self._freshness(),
            steps=int(values.get("environment_steps", 0)),
            steps_rate=learner.rate("environment_steps") if learner else None,
            updates=int(values.get("updates", 0)),
            updates_rate=learner.rate("updates") if learner else None,
            staleness=float(values["lag_versions"]) if "lag_versions" in values else None,
            learner_wait=self._learner_wait(),
            worker_wait=self._worker_wait(),
            ledger=_ledger(values.get("ledger", {})),
            others=(int(ledgers[OTHERS].get("workers", 0)), _ledger(ledgers[OTHERS])) if OTHERS in ledgers else None,
            imitation=self._imitation(),
            processes=rows,
            alarms=(*alarms, *complaints, *self._alarms(values)),
        )

    def learner_values(self) -> dict[str, Any]:
        """Return the figures of the learner's newest metric message, empty before the first."""
        learner = self._of("learner")
        return dict(learner.values) if learner else {}

    def _of(self, role: str) -> _Seen | None:
        found = [seen for (kind, _), seen in self._seen.items() if kind == role]
        return max(found, key=lambda seen: seen.at) if found else None

    def _freshness(self) -> tuple[Series, ...]:
        shown = FRESHNESS if all(kind in self._figures for kind in FRESHNESS) else LENGTH
        return tuple(
            Series(name, tuple(self._figures[kind]), 2 if shown is FRESHNESS else 0)
            for kind, name in shown.items()
            if kind in self._figures
        )

    def _learner_wait(self) -> float | None:
        learner = self._of("learner")
        if learner is None or learner.message is None:
            return None
        return _share(learner.values.get("waits", {}).get("data"), learner.message.uptime)

    def _worker_wait(self) -> float | None:
        shares = [
            _share(seen.values.get("waiting_seconds"), seen.message.uptime)
            for (role, _), seen in self._seen.items()
            if role == "rollout" and seen.message is not None
        ]
        known = [share for share in shares if share is not None]
        return sum(known) / len(known) if known else None

    def _imitation(self) -> Imitation:
        elite, learner = self._of("elite"), self._of("learner")
        values = elite.values if elite else {}
        events = int(learner.values.get("event", 0)) if learner else 0
        return Imitation(
            events=events,
            rate=float(values["rate"]) if values.get("rate") else None,
            next_episode=int(values["next_episode"]) if values.get("next_episode") else None,
            elites=tuple(
                (LETTERS.get(kind, str(kind)[:NAME]), int(index)) for kind, index in values.get("elites", {}).items()
            ),
            newest=tuple(map(_imitated, learner.values.get("imitations", []))) if learner else (),
        )

    def _row(self, name: tuple[str, str], seen: _Seen, learner: dict[str, Any], ledgers: dict[str, Any]) -> ProcessRow:
        message, values, role = seen.message, seen.values, name[0]
        queue = values.get("queue", values.get("spooled"))
        follows = role == "rollout" and message is not None and "version" in learner
        ledger = None
        if role == "rollout":
            known, others = ledgers.get(name[1]), ledgers.get(OTHERS, {})
            # Beyond the rows that the learner tells there is the worker's own account, which knows of no loss.
            own = {**values, "lost": None if others.get("lost") else 0}
            ledger = _ledger(known) if known else _ledger(own) if values else None
        return ProcessRow(
            role=role,
            name=name[1],
            host=plain(message.host) if message else "-",
            pid=message.pid if message else 0,
            uptime=message.uptime if message else 0.0,
            rate=seen.rate(COUNTED[role]) if role in COUNTED else None,
            version=seen.version,
            behind=max(0, int(learner["version"]) - seen.version) if follows else None,
            episodes=int(values["episodes"]) if "episodes" in values else None,
            queue=int(queue) if queue is not None else None,
            age=time.monotonic() - seen.at if message else 0.0,
            alive=seen.alive,
            ledger=ledger,
        )

    def _alarms(self, learner: dict[str, Any]) -> tuple[str, ...]:
        found = _few(learner.get("alarms", []), "")
        elite = self._of("elite")
        if elite is not None and elite.values.get("failures"):
            found.append(f"{elite.values['failures']} evaluations for imitation were not answered in time.")
        for (role, name), seen in self._seen.items():
            if role != "learner":
                found += _few(seen.values.get("alarms", []), f"{role} {name}: ")
        ledger = learner.get("ledger", {})
        if ledger.get("lost"):
            found.append(f"{ledger['lost']} environment steps are lost with processes that died.")
        if ledger.get("rejected") or learner.get("malformed"):
            found.append(
                f"{ledger.get('refused', 0)} chunks were refused and {learner.get('malformed', 0)} requests dropped."
            )
        if learner.get("replaced"):
            found.append(f"{learner['replaced']} requests came from starts of workers that have been replaced.")
        if ledger.get("unexplained"):
            found.append(f"{ledger['unexplained']} environment steps are unexplained.")
        missed = sum(seen.missed for seen in self._seen.values())
        if missed:
            found.append(f"{missed} metric messages were missed by this view.")
        if self._malformed:
            found.append(f"{self._malformed} metric messages could not be read.")
        return tuple(found)


def _check(values: dict[str, Any]) -> None:
    """Raise one of UNREADABLE where figures are not of the form in which a view reads them."""
    for ledger in (values.get("ledger", {}), *values.get("ledgers", {}).values()):
        _ledger(ledger)
        int(ledger.get("workers", 0))
    for event in values.get("imitations", []):
        _imitated(event)
    for name in ("elites", "waits", "curves"):
        if not isinstance(values.get(name, {}), dict):
            raise SchemaError(f"{name} is no map.")
    for number in (*values.get("elites", {}).values(), *values.get("waits", {}).values()):
        float(number)
    float(values.get("rate", 0)), float(values.get("next_episode", 0)), int(values.get("failures", 0))
    if not all(isinstance(text, str) for text in values.get("alarms", [])):
        raise SchemaError("an alarm is no text.")


def _few(texts: Sequence[str], who: str) -> list[str]:
    """Return the first of a process's alarms, each a line, and how many more there are."""
    more = len(texts) - MOST_ALARMS
    return [f"{who}{text}"[:200] for text in texts[:MOST_ALARMS]] + ([f"{who}{more} more alarms."] if more > 0 else [])


def _ledger(figures: dict[str, Any]) -> Ledger:
    names = ("produced", "accepted", "duplicates", "rejected", "in_flight", "unexplained")
    lost = figures.get("lost", 0)
    return Ledger(**{name: int(figures.get(name, 0)) for name in names}, lost=None if lost is None else int(lost))


def _imitated(event: dict[str, Any]) -> ImitationRow:
    scores = event.get("scores", {})
    return ImitationRow(
        event=int(event["event"]),
        episode=int(event["episode"]),
        rate=float(event["rate"]),
        elites=tuple(
            (LETTERS.get(kind, str(kind)[:NAME]), int(elite), _score(scores.get(kind), int(elite)))
            for kind, elite in event["elites"].items()
        ),
    )


def _score(scores: Any, elite: int) -> float | None:
    """Return an elite's score, None where it is not told or not finite."""
    return None if scores is None or scores[elite] is None else float(scores[elite])


def _digits(points: Sequence[float]) -> int:
    """Return the decimals of a curve: none for hundreds, two for small numbers."""
    return 0 if max(map(abs, points), default=0.0) >= 100.0 else 2


def _share(part: Any, whole: float) -> float | None:
    return None if part is None or whole <= 0 else min(1.0, float(part) / whole)
