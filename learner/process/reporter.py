"""Reports the state of training as a metric message, TensorBoard scalars and a line of metrics.jsonl."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from eia_sec.common.config.files import plain_options
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.population import Exploit
from eia_sec.common.process import Presence
from eia_sec.common.protocol.metrics import EPISODIC_RETURN, MEAN_REWARD, flattened, scalars
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.learner.process.curves import Curves
from eia_sec.learner.process.metrics_log import MetricsLog, exploit_record, imitation_record
from eia_sec.learner.process.tensorboard import TensorBoardWriter
from eia_sec.learner.trainer import Trainer

IMITATIONS: Final = 4
"""Number of imitation events, and of rounds of a population, in a metric message, the newest ones."""
MetricSource = Callable[[], Mapping[str, Any]]
AlarmSource = Callable[[], Sequence[str]]


class Reporter:
    """Collects metrics and alarms from the learner's parts and reports them.

    Args:
        directory: the run directory, or None.
        environment: its team and its episode metrics.
        trainer: its counters and statistics are part of each report.
        presence: publishes metric messages.
        episodes: training episodes of the run.
        elapsed: seconds that earlier parts of a resumed run took.
    """

    def __init__(
        self,
        directory: Path | None,
        environment: EnvironmentSpec,
        trainer: Trainer,
        presence: Presence,
        elapsed: float = 0.0,
    ) -> None:
        self._team, self._trainer, self._presence = environment.team, trainer, presence
        self._labels = environment.labels()
        self._types = environment.team.types
        descriptions = {f"charts/{m.name}": f"{m.meaning}, {m.unit}" for m in environment.episode_metrics}
        self._log, self._tensorboard = MetricsLog(directory, elapsed), TensorBoardWriter(directory, descriptions)
        self._tensorboard.configuration(plain_options(trainer.config), (EPISODIC_RETURN, MEAN_REWARD))
        self._curves = Curves(environment.team, trainer.recent)
        self._imitations: deque[dict[str, Any]] = deque(maxlen=IMITATIONS)
        self._exploits: deque[dict[str, Any]] = deque(maxlen=IMITATIONS)
        self._metrics: list[MetricSource] = []
        self._alarms: list[AlarmSource] = []

    @property
    def elapsed(self) -> float:
        """Seconds since the run began, without the pauses between its starts."""
        return self._log.elapsed

    @property
    def metrics(self) -> Mapping[str, float]:
        """Rewards, episode metrics and diagnostics by TensorBoard's names."""
        return scalars({"curves": self._curves.smoothed(), "statistics": self._trainer.statistics()}, self._types)

    def add(self, metrics: MetricSource | None = None, alarms: AlarmSource | None = None) -> None:
        """Add a source of metrics, alarms or both, which every report then includes."""
        if metrics is not None:
            self._metrics.append(metrics)
        if alarms is not None:
            self._alarms.append(alarms)

    def log_resume(self) -> None:
        """Record the counters from which the run continues; they supersede earlier records beyond them."""
        counters = ("episodes", "environment_steps", "updates", "events")
        self._log.write("resume", **{name: getattr(self._trainer, name) for name in counters})
        self._tensorboard.resume(self._trainer.environment_steps)

    def log_episodes(self, episodes: Sequence[EpisodeSummary]) -> None:
        """Record finished episodes."""
        t, means = self._trainer, self._curves.add(episodes)
        counters = {"episodes": t.episodes, "environment_steps": t.environment_steps, "updates": t.updates}
        self._log.write("episodes", **counters, **means)

    def log_imitation(self, event: ImitationEvent) -> None:
        """Record an applied imitation event."""
        record = {"episodes": self._trainer.episodes, **imitation_record(self._team, event)}
        self._imitations.append(record)
        self._log.write("imitation", **record)

    def log_exploit(self, event: Exploit, before: Mapping[str, float]) -> None:
        """Record an applied round of a population, and the hyperparameters before it."""
        counters = {name: getattr(self._trainer, name) for name in ("episodes", "environment_steps", "updates")}
        record = {**counters, **exploit_record(self._team, event, before)}
        self._exploits.append(record)
        self._log.write("exploit", **record)

    def log_end(self, state: str) -> None:
        """Record the learner's final state and the digest of its final actors."""
        self._log.write("end", state=state, episodes=self._trainer.episodes, digest=self._trainer.actors().digest())

    def report(self, state: str) -> None:
        """Report all metrics and alarms.

        Args:
            state: training, draining or finished.
        """
        t = self._trainer
        metrics: dict[str, Any] = {
            "state": state,
            "episodes": t.episodes,
            "episodes_total": t.config.episodes,
            "steps_total": t.config.steps,
            "progress": t.progress,
            "environment_steps": t.environment_steps,
            "updates": t.updates,
            "version": t.version,
            "event": t.events,
            "elapsed": self.elapsed,
            "steps_per_second": t.environment_steps / max(self.elapsed, 1e-9),
            "curves": self._curves.smoothed(),
            "statistics": t.statistics(),
            "evaluation_steps": t.evaluation_steps,
        }
        for source in self._metrics:
            metrics |= source()
        alarms = self._current_alarms(metrics["statistics"])
        message = {**metrics, "imitations": list(self._imitations), "environment": self._labels, "alarms": alarms}
        if t.config.population.members:
            message["exploits"] = list(self._exploits)
        self._presence.report(message, t.version)
        agents = t.agent_statistics()
        shown = scalars(metrics, self._types) | flattened({"agents": agents})
        self._tensorboard.write(t.environment_steps, shown)
        self._log.write("status", **metrics, agents=agents)

    def close(self) -> None:
        """Close the files."""
        self._log.close()
        self._tensorboard.close()

    def _current_alarms(self, statistics: Mapping[str, Any]) -> list[str]:
        own = (diverging(statistics), self._log.failure, self._tensorboard.failure)
        return [text for text in own if text] + [text for source in self._alarms for text in source() if text]


def diverging(statistics: Mapping[str, Any]) -> str:
    """Return a sentence that names a statistic that is not finite, or an empty string."""
    odd = sorted(name for name, value in flattened(statistics).items() if not math.isfinite(value))
    more = f" and {len(odd) - 1} more" if len(odd) > 1 else ""
    return f"the training diverges: {odd[0]}{more} is not finite." if odd else ""
