"""The state of a run as a plain subscriber sees it: metric messages and liveliness tokens, put into a snapshot."""

from collections import deque
from collections.abc import Collection, Sequence
from typing import Any, Final

from eia_sec.common.callbacks import SHOWN
from eia_sec.common.clock import monotonic
from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, MetricMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.deploy.monitor.alarms import examine
from eia_sec.deploy.monitor.environment_labels import NAME_LENGTH, plotted, value_of
from eia_sec.deploy.monitor.process_report import (
    COUNTED,
    ProcessReport,
    elites_of,
    imitation_row,
    ledger_of,
    membership_of,
    noise_free_of,
)
from eia_sec.deploy.monitor.sanitised import plain
from eia_sec.deploy.monitor.snapshot import Imitation, ProcessRow, Series, Snapshot
from eia_sec.learner.intake.ledger import OTHERS

HISTORY: Final = 240
"""Points of a curve that are kept."""
GONE_SECONDS: Final = 30.0
"""A process without a token stays in the table for this long."""
MOST_ROWS: Final = 1024
"""Most processes that are followed; what further ones send is counted."""
MOST_ELITES: Final = 4
"""Most coordinators that are followed; a run has one at a time."""
LEARNER: Final = "learner"
"""The learner's role, and its name."""
MOST_ALARMS: Final = 64
"""Most alarms of processes other than the learner that are shown; the rest are counted."""
WAITING: Final = 4096
"""Messages that wait to be read; the oldest are dropped."""
MOST_CURVES: Final = 64
"""Most types of agent whose reward is followed."""
MOST_TEXT: Final = 200
"""Most characters of an alarm."""
UNREADABLE: Final = (ProtocolError, TypeError, ValueError, LookupError, AttributeError, OverflowError, RecursionError)
"""Errors that reading malformed metrics raises."""


class _TurnedAwayError(ProtocolError):
    """A message of a process that is not followed, because too many are."""


class RunMonitor:
    """The live state of one run, from its processes' metrics and liveliness tokens.

    Args:
        bus: the control lane; only subscriptions are made on it.
        run: the run's name.
    """

    def __init__(self, bus: Bus, run: str) -> None:
        self._run = run
        self._metrics = bus.subscribe(keys.METRIC.pattern(run), WAITING)
        self._tokens = bus.watch(keys.LIVE.pattern(run), WAITING)
        self._reports: dict[tuple[str, str], ProcessReport] = {}
        self._rewards: dict[str, deque[float]] = {}
        self._others: dict[str, deque[float]] = {}
        self._noise_free: deque[float] = deque(maxlen=HISTORY)
        self._malformed = self._turned_away = 0

    def update(self) -> None:
        """Process the messages that have arrived."""
        now = monotonic()
        for sample in self._tokens.drain():
            try:
                variables = keys.parse(sample.key).variables
                seen = self._of_name((variables["role"], variables["name"]))
                seen.alive, seen.announced, seen.change = sample.present, True, now
            except _TurnedAwayError:
                self._turned_away += 1
            except (ProtocolError, KeyError):
                self._malformed += 1
        for sample in self._metrics.drain():
            try:
                parsed = keys.parse(sample.key)
                sender, message = Envelope.decode(sample.attachment), MetricMessage.decode(sample.payload)
                if (sender.role, sender.name) != (parsed.variables["role"], parsed.variables["name"]):
                    raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}.")
                self._take((parsed.variables["role"], parsed.variables["name"]), sender, message, now)
            except _TurnedAwayError:
                self._turned_away += 1
            except UNREADABLE:
                self._malformed += 1
        for name, seen in list(self._reports.items()):
            # A process that never had a token is gone when it is silent.
            gone = now - seen.change if not seen.alive else 0.0 if seen.announced else now - seen.at
            if gone > GONE_SECONDS:
                del self._reports[name]

    def _of_name(self, name: tuple[str, str]) -> ProcessReport:
        """Return what is kept of a process; raise _TurnedAwayError when there is no room for one more."""
        role = name[0]
        if name in self._reports:
            return self._reports[name]
        if role == LEARNER:
            known = name == (LEARNER, LEARNER)  # there is always room for it
        elif role == "elite":
            known = sum(kind == role for kind, _ in self._reports) < MOST_ELITES
        else:
            known = len(self._reports) < MOST_ROWS
        if not known:
            raise _TurnedAwayError(f"{role} {name[1]} is one process too many.")
        self._reports[name] = ProcessReport()
        return self._reports[name]

    def _take(self, name: tuple[str, str], sender: Envelope, message: MetricMessage, now: float) -> None:
        seen = self._of_name(name)
        before, _ = noise_free_of(seen.values)
        seen.follow(name[0], message, sender.version, now)
        if name[0] == "elite":
            number, reward = noise_free_of(seen.values)
            if number not in (0, before):
                self._noise_free.append(reward)
        if name[0] == LEARNER and seen.values.get("curves"):
            curves = seen.values["curves"]
            shown = {curve.name: value_of(curves, curve) for curve in plotted(seen.values)}
            others = {name: value for name, value in shown.items() if value is not None}
            for part, values in ((self._rewards, curves.get("reward", {})), (self._others, others)):
                for kind, value in values.items():
                    if kind not in part and len(part) >= MOST_CURVES:
                        raise SchemaError(f"there are more than {MOST_CURVES} curves.")
                    part.setdefault(kind, deque(maxlen=HISTORY)).append(float(value))

    def snapshot(self, alarms: tuple[str, ...] = ()) -> Snapshot:
        """Return the current state for `eia_sec.deploy.monitor.live_view.render`, with the caller's alarms first."""
        try:
            return self._snapshot(alarms)
        except UNREADABLE:
            # One process's metrics cannot be shown, so the view continues without any until the next reports.
            self._malformed += 1
            for seen in self._reports.values():
                seen.drop()
            return self._snapshot(alarms)

    def _snapshot(self, alarms: tuple[str, ...]) -> Snapshot:
        values = self.learner_values()
        elapsed = float(values.get("elapsed", 0.0))
        progress = float(values.get("progress", 0.0))
        ledgers, learner = values.get("ledgers", {}), self._of(LEARNER)
        rows = tuple(self._row(name, seen, values, ledgers) for name, seen in sorted(self._reports.items()))
        before = sorted(name for name in ledgers if name != OTHERS and ("rollout", name) not in self._reports)
        room = max(0, MOST_ROWS - len(rows))
        rows += tuple(
            ProcessRow("rollout", name, "-", 0, 0.0, alive=False, ledger=ledger_of(ledgers[name]), left=True)
            for name in before[:room]
        )
        over = values.get("state") in ("draining", "finished") or progress >= 1.0
        rows, complaints = examine(rows, training=values.get("state") == "training" and not over, over=over)
        if orphaned := _lacks_learner(rows):
            complaints.append("no learner is there, and workers hold the parameters of one.")
        return Snapshot(
            run=self._run,
            state=str(values.get("state", "without learner" if orphaned else "starting")),
            elapsed=elapsed,
            left=elapsed * (1.0 - progress) / progress if progress > 0.0 else None,
            episodes=int(values.get("episodes", 0)),
            episodes_total=int(values.get("episodes_total", 0)),
            steps_total=int(values.get("steps_total", 0)),
            progress=progress,
            reward=tuple(
                Series(str(kind)[:NAME_LENGTH], tuple(points), _digits(points))
                for kind, points in self._rewards.items()
            ),
            noise_free=Series("without noise", tuple(self._noise_free), _digits(self._noise_free), smoothing=1),
            freshness=self._freshness(),
            steps=int(values.get("environment_steps", 0)),
            steps_rate=learner.rate("environment_steps") if learner else None,
            updates=int(values.get("updates", 0)),
            updates_rate=learner.rate("updates") if learner else None,
            staleness=float(values["lag_versions"]) if "lag_versions" in values else None,
            learner_wait=self._learner_wait(),
            worker_wait=self._worker_wait(),
            ledger=ledger_of(values.get("ledger", {})),
            others=(int(ledgers[OTHERS].get("workers", 0)), ledger_of(ledgers[OTHERS])) if OTHERS in ledgers else None,
            outages=self._sum("outages"),
            step_timeouts=self._sum("step_timeouts"),
            imitation=self._imitation(),
            population=membership_of(values, self._run),
            processes=rows,
            alarms=(*alarms, *complaints, *self._alarms(values), *_hidden(len(before) - room, self._turned_away)),
        )

    def learner_values(self) -> dict[str, Any]:
        """Return the metrics of the learner's newest metric message, empty before the first."""
        learner = self._of(LEARNER)
        return dict(learner.values) if learner else {}

    def stopped_by(self) -> str:
        """Return why a callback of a plug-in has stopped the run, or an empty string."""
        return str(self.learner_values().get("stopped", ""))[:SHOWN]

    @property
    def trains(self) -> bool:
        """Whether the learner says that it trains."""
        return self.learner_values().get("state") == "training"

    def _of(self, role: str) -> ProcessReport | None:
        found = [seen for (kind, _), seen in self._reports.items() if kind == role]
        return max(found, key=lambda seen: seen.at) if found else None

    def _sum(self, counter: str) -> int:
        """Return the sum of a counter of all workers."""
        return sum(int(seen.values.get(counter, 0)) for (role, _), seen in self._reports.items() if role == "rollout")

    def _freshness(self) -> tuple[Series, ...]:
        return tuple(
            Series(curve.label, tuple(self._others[curve.name]), curve.digits)
            for curve in plotted(self.learner_values())
            if curve.name in self._others
        )

    def _learner_wait(self) -> float | None:
        learner = self._of(LEARNER)
        if learner is None or learner.message is None:
            return None
        return _share(learner.values.get("waits", {}).get("data"), learner.message.uptime)

    def _worker_wait(self) -> float | None:
        shares = [
            _share(seen.values.get("waiting_seconds"), seen.message.uptime)
            for (role, _), seen in self._reports.items()
            if role == "rollout" and seen.message is not None
        ]
        known = [share for share in shares if share is not None]
        return sum(known) / len(known) if known else None

    def _imitation(self) -> Imitation:
        elite, learner = self._of("elite"), self._of(LEARNER)
        values, reported = elite.values if elite else {}, self.learner_values()
        events = int(learner.values.get("event", 0)) if learner else 0
        return Imitation(
            events=events,
            rate=float(values["rate"]) if values.get("rate") else None,
            next_episode=int(values["next_episode"]) if values.get("next_episode") else None,
            shared=bool(values.get("shared")),
            elites=elites_of(values, reported),
            newest=tuple(imitation_row(event, reported) for event in reported.get("imitations", [])),
        )

    def _row(
        self, name: tuple[str, str], seen: ProcessReport, learner: dict[str, Any], ledgers: dict[str, Any]
    ) -> ProcessRow:
        message, values, role = seen.message, seen.values, name[0]
        queue = values.get("queue", values.get("spooled"))
        follows = role == "rollout" and message is not None and "version" in learner
        ledger = None
        if role == "rollout":
            known, others = ledgers.get(name[1]), ledgers.get(OTHERS, {})
            # A worker that the learner does not list is shown by its own counts, which do not include losses.
            own = {**values, "lost": None if others.get("lost") else 0}
            ledger = ledger_of(known) if known else ledger_of(own) if values else None
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
            age=monotonic() - seen.at if message else 0.0,
            alive=seen.alive,
            ledger=ledger,
            waits=seen.waits() if role == "rollout" else None,
        )

    def _alarms(self, learner: dict[str, Any]) -> tuple[str, ...]:
        found = [text[:MOST_TEXT] for text in learner.get("alarms", [])]
        elite = self._of("elite")
        if elite is not None and elite.values.get("failures"):
            found.append(f"{elite.values['failures']} evaluations for imitation events timed out.")
        others = [
            f"{role} {name}: {text}"[:MOST_TEXT]
            for (role, name), seen in self._reports.items()
            if role != LEARNER
            for text in seen.values.get("alarms", [])
        ]
        found += others[:MOST_ALARMS]
        found += [f"{len(others) - MOST_ALARMS} more alarms of other processes."] if len(others) > MOST_ALARMS else []
        ledger = learner.get("ledger", {})
        if ledger.get("lost"):
            found.append(f"{ledger['lost']} environment steps were lost with processes that died.")
        if ledger.get("rejected") or learner.get("malformed"):
            found.append(
                f"chunks refused: {ledger.get('refused', 0)}; requests dropped: {learner.get('malformed', 0)}."
            )
        if learner.get("replaced"):
            found.append(f"{learner['replaced']} requests came from starts of workers that have been replaced.")
        if ledger.get("unexplained"):
            found.append(f"{ledger['unexplained']} environment steps are unexplained.")
        if timeouts := self._sum("step_timeouts"):
            found.append(f"{timeouts} calls of environments took longer than env.step_timeout; workers were replaced.")
        missed = sum(seen.missed for seen in self._reports.values())
        if missed:
            found.append(f"{missed} metric messages did not reach this view; the run misses nothing.")
        if self._malformed:
            found.append(f"{self._malformed} metric messages were malformed.")
        return tuple(found)


def _lacks_learner(rows: Sequence[ProcessRow]) -> bool:
    """Return whether no learner is there though there was one: workers hold its parameters."""
    return all(row.role != LEARNER for row in rows) and any(
        row.role == "rollout" and row.alive and row.version for row in rows
    )


def _hidden(rows: int, messages: int) -> list[str]:
    """Return what is said when more processes report than a view follows."""
    found = [f"{rows} workers that have left are not shown: a view has {MOST_ROWS} rows."] if rows > 0 else []
    if messages:
        found.append(f"{messages} messages of further processes were dropped: a view follows {MOST_ROWS}.")
    return found


def _digits(points: Collection[float]) -> int:
    """Return the decimals of a curve: none for hundreds, two for small numbers."""
    return 0 if max(map(abs, points), default=0.0) >= 100.0 else 2


def _share(part: Any, whole: float) -> float | None:
    return None if part is None or whole <= 0 else min(1.0, float(part) / whole)
