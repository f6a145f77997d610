"""Applies what the coordinator of a population sends after each round."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import SchemaError
from eia_sec.common.population import Exploit, hyperparameters_of, round_due
from eia_sec.common.protocol.messages import ExploitMessage
from eia_sec.common.transport.bus import Server
from eia_sec.learner.process.event_server import EventServer
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.trainer import Trainer

ALARM_SECONDS: Final = 10.0
"""Time for which a round may be due while nobody leads before that raises an alarm."""


class PopulationServer(EventServer[ExploitMessage]):
    """Answers requests to apply a round of a population; see `EventServer`.

    Args:
        server: where they come in.
        trainer: the trainer that takes part.
        lease: which coordinator leads.
        epoch: the learner's fencing epoch.
        on_applied: called with each applied round and the hyperparameters before it, before it is acknowledged.
    """

    what, requests, message = "round", "rounds of the population", ExploitMessage

    def __init__(
        self,
        server: Server,
        trainer: Trainer,
        lease: Lease,
        epoch: int,
        on_applied: Callable[[Exploit, Mapping[str, float]], None],
    ) -> None:
        super().__init__(server, trainer, lease, epoch)
        self._on_applied = on_applied
        self._unled: float | None = None

    def _apply(self, message: ExploitMessage) -> Callable[[], None] | None:
        # One that is not due here yet is that of others: this learner has joined late, or was away.
        newest = round_due(self._trainer.config, 1.0)
        if message.round > newest:
            raise SchemaError(f"round {message.round} never falls due in this run; the last one is {newest}.")
        event, before = message.to_event(), hyperparameters_of(self._trainer.config)
        return partial(self._on_applied, event, before) if self._trainer.exploit(event) else None

    def metrics(self) -> dict[str, Any]:
        """Return the metrics to report; of a run alone there are none."""
        trainer = self._trainer
        if not trainer.config.population.members:
            return {}
        values = hyperparameters_of(trainer.config)
        return {"round": trainer.round, "hyperparameters": values, "rounds_refused": self.refused}

    def alarms(self) -> list[str]:
        """Return a sentence if requests were refused, and one if a round is due and nobody is there to hold it."""
        overdue = self._overdue()
        return [*([overdue] if overdue else []), *super().alarms()]

    def _overdue(self) -> str:
        """Return a sentence about a round that is due without a coordinator; one may wait for slower members."""
        trainer, now = self._trainer, monotonic()
        if round_due(trainer.config, trainer.progress) <= trainer.round or self._lease.current(now):
            self._unled = None
            return ""
        self._unled = now if self._unled is None else self._unled
        if now - self._unled < ALARM_SECONDS:
            return ""
        number, interval = trainer.round + 1, trainer.config.population.interval
        return (
            f"round {number} of the population has been due since {number * interval:.1%} of the run, and no "
            "coordinator leads; is one running?"
        )

    def ending(self) -> str:
        """Return the end of a sentence with the newest of all rounds that the learner took part in; "" alone."""
        config = self._trainer.config
        if not config.population.members:
            return ""
        return f"; the newest round of the population was {self._trainer.round} of {round_due(config, 1.0)}"
