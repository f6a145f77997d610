"""The fleet as a plain subscriber sees it: metric messages and liveliness tokens, put together into a snapshot."""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from common import keys
from common.bus import Bus
from common.errors import ProtocolError
from common.messages import Envelope, MetricMessage
from common.team import LETTERS
from deploy.view import Imitation, Ledger, ProcessRow, Series, Snapshot

HISTORY: Final = 240
"""Points of a curve that are kept."""
GONE_SECONDS: Final = 30.0
"""A process without a token stays in the table for this long."""
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
    rate: float = 0.0
    missed: int = 0
    alive: bool = True
    change: float = field(default_factory=time.monotonic)


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
        self._rates = {"environment_steps": 0.0, "updates": 0.0}
        self._malformed = 0

    def update(self) -> None:
        """Take in what has arrived."""
        now = time.monotonic()
        for sample in self._tokens.drain():
            try:
                variables = keys.parse(sample.key).variables
                seen = self._seen.setdefault((variables["role"], variables["name"]), _Seen())
                seen.alive, seen.change = sample.present, now
            except (ProtocolError, KeyError):
                self._malformed += 1
        for sample in self._metrics.drain():
            try:
                parsed = keys.parse(sample.key)
                sender, message = Envelope.decode(sample.attachment), MetricMessage.decode(sample.payload)
                if (sender.role, sender.name) != (parsed.variables["role"], parsed.variables["name"]):
                    raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}.")
                self._take((parsed.variables["role"], parsed.variables["name"]), sender, message, now)
            except (ProtocolError, KeyError, TypeError, ValueError):
                self._malformed += 1
        for name, seen in list(self._seen.items()):
            if not seen.alive and now - seen.change > GONE_SECONDS:
                del self._seen[name]

    def _take(self, name: tuple[str, str], sender: Envelope, message: MetricMessage, now: float) -> None:
        seen = self._seen.setdefault(name, _Seen())
        counted = "updates" if name[0] == "learner" else "environment_steps"
        if seen.message is not None and seen.message.pid == message.pid:
            seen.missed += max(0, message.counter - seen.message.counter - 1)
            span = message.uptime - seen.message.uptime
            if span > 0:
                seen.rate = (message.values.get(counted, 0) - seen.values.get(counted, 0)) / span
                if name[0] == "learner":
                    for key in self._rates:
                        self._rates[key] = (message.values[key] - seen.values[key]) / span
        seen.message, seen.values, seen.version, seen.at = message, message.values, sender.version, now
        if name[0] == "learner" and message.values.get("curves"):
            curves = message.values["curves"]
            figures = {kind: curves[kind] for kind in (*FRESHNESS, *LENGTH) if kind in curves}
            for part, values in ((self._rewards, curves["reward"]), (self._figures, figures)):
                for kind, value in values.items():
                    part.setdefault(str(kind), deque(maxlen=HISTORY)).append(float(value))

    def snapshot(self, alarms: tuple[str, ...] = ()) -> Snapshot:
        """Return the present state for `deploy.view.render`, with the caller's alarms before its own."""
        try:
            return self._snapshot(alarms)
        except (TypeError, ValueError, KeyError, AttributeError):
            # Somebody's figures are not figures: without them the view goes on.
            self._malformed += 1
            for seen in self._seen.values():
                seen.values = {}
            return self._snapshot(alarms)

    def _snapshot(self, alarms: tuple[str, ...]) -> Snapshot:
        values = self.learner_values()
        elapsed = float(values.get("elapsed", 0.0))
        episodes, total = int(values.get("episodes", 0)), int(values.get("episodes_total", 0))
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
            steps_rate=self._rates["environment_steps"],
            updates=int(values.get("updates", 0)),
            updates_rate=self._rates["updates"],
            staleness=float(values["lag_versions"]) if "lag_versions" in values else None,
            learner_wait=_share(values.get("waits", {}).get("data"), elapsed),
            worker_wait=self._worker_wait(),
            ledger=self._ledger(values.get("ledger", {})),
            imitation=self._imitation(),
            processes=tuple(self._row(name, seen) for name, seen in sorted(self._seen.items())),
            alarms=alarms + self._alarms(values),
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

    def _worker_wait(self) -> float | None:
        shares = [
            _share(seen.values.get("waiting_seconds"), seen.message.uptime)
            for (role, _), seen in self._seen.items()
            if role == "rollout" and seen.message is not None
        ]
        known = [share for share in shares if share is not None]
        return sum(known) / len(known) if known else None

    def _ledger(self, totals: dict[str, Any]) -> Ledger:
        names = ("produced", "accepted", "duplicates", "rejected", "lost", "in_flight", "unexplained")
        return Ledger(**{name: int(totals.get(name, 0)) for name in names})

    def _imitation(self) -> Imitation:
        elite, learner = self._of("elite"), self._of("learner")
        values = elite.values if elite else {}
        events = int(learner.values.get("event", 0)) if learner else 0
        return Imitation(
            events=events,
            rate=float(values["rate"]) if values.get("rate") else None,
            next_episode=int(values["next_episode"]) if values.get("next_episode") else None,
            elites=tuple(
                (LETTERS.get(kind, str(kind)), int(index)) for kind, index in values.get("elites", {}).items()
            ),
        )

    def _row(self, name: tuple[str, str], seen: _Seen) -> ProcessRow:
        message, values = seen.message, seen.values
        queue = values.get("queue", values.get("spooled"))
        return ProcessRow(
            role=name[0],
            name=name[1],
            host=message.host if message else "-",
            pid=message.pid if message else 0,
            uptime=message.uptime if message else 0.0,
            rate=seen.rate if message else None,
            version=seen.version,
            episodes=values.get("episodes"),
            queue=int(queue) if queue is not None else None,
            age=time.monotonic() - seen.at if message else 0.0,
            alive=seen.alive,
        )

    def _alarms(self, learner: dict[str, Any]) -> tuple[str, ...]:
        found = [str(text)[:200] for text in learner.get("alarms", [])]
        found += [f"{role} {name} is gone." for (role, name), seen in self._seen.items() if not seen.alive]
        elite = self._of("elite")
        if elite is not None and elite.values.get("failures"):
            found.append(f"{elite.values['failures']} evaluations for imitation were not answered in time.")
        for (role, name), seen in self._seen.items():
            if role != "learner":
                found += [f"{role} {name}: {text}"[:200] for text in seen.values.get("alarms", [])]
        ledger = learner.get("ledger", {})
        if ledger.get("lost"):
            found.append(f"{ledger['lost']} environment steps are lost with processes that died.")
        if ledger.get("rejected") or learner.get("malformed"):
            found.append(
                f"{ledger.get('refused', 0)} chunks were refused and {learner.get('malformed', 0)} requests dropped."
            )
        if ledger.get("unexplained"):
            found.append(f"{ledger['unexplained']} environment steps are unexplained.")
        missed = sum(seen.missed for seen in self._seen.values())
        if missed:
            found.append(f"{missed} metric messages were missed by this view.")
        if self._malformed:
            found.append(f"{self._malformed} metric messages could not be read.")
        return tuple(found)


def _digits(points: Sequence[float]) -> int:
    """Return the decimals of a curve: none for hundreds, two for small numbers."""
    return 0 if max(map(abs, points), default=0.0) >= 100.0 else 2


def _share(part: Any, whole: float) -> float | None:
    return None if part is None or whole <= 0 else min(1.0, float(part) / whole)
