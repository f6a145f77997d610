"""Applies what the coordinator of a population sends after each round."""

from collections.abc import Callable, Mapping
from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.population import Exploit, hyperparameters_of, round_due
from eia_sec.common.protocol.messages import Envelope, ExploitMessage, ReceiptMessage
from eia_sec.common.transport.bus import Incoming, Server
from eia_sec.learner.process.imitation_server import LONGEST_REASON
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.trainer import Trainer

ALARM_SECONDS: Final = 10.0
"""Time for which a round may be due while nobody leads before that raises an alarm."""


class PopulationServer:
    """Answers requests to apply a round of a population.

    Args:
        server: where they come in.
        trainer: the trainer that takes part.
        lease: which coordinator leads; rounds of others are refused.
        epoch: the learner's fencing epoch; rounds for another epoch are refused.
        on_applied: called with each applied round and the hyperparameters before it, before it is acknowledged.

    Attributes:
        refused: requests that were not applied and never will be.
    """

    def __init__(
        self,
        server: Server,
        trainer: Trainer,
        lease: Lease,
        epoch: int,
        on_applied: Callable[[Exploit, Mapping[str, float]], None],
    ) -> None:
        self._server, self._trainer, self._lease, self._epoch = server, trainer, lease, epoch
        self._on_applied = on_applied
        self.refused, self._reason = 0, ""
        self._unled: float | None = None

    def answer(self) -> None:
        """Answer every waiting request."""
        for incoming in self._server.waiting():
            before = hyperparameters_of(self._trainer.config)
            try:
                event = self._checked(incoming)
                applied = self._trainer.exploit(event)
            except ProtocolError as error:
                self.refused, self._reason = self.refused + 1, str(error)[:LONGEST_REASON]
                incoming.reply(ReceiptMessage(False, self._reason).encode())
                continue
            if applied:
                self._on_applied(event, before)
            incoming.reply(ReceiptMessage(True, "" if applied else "applied before").encode())

    def _checked(self, incoming: Incoming) -> Exploit:
        message = ExploitMessage.decode(incoming.payload)
        if message.epoch != self._epoch:
            raise ProtocolError("the round is for another start of the learner.")
        sender = Envelope.decode(incoming.attachment)
        if not self._lease.holds(sender.name, sender.incarnation):
            raise ProtocolError("another coordinator leads.")
        due = round_due(self._trainer.config, self._trainer.progress)
        if message.round > due:
            raise SchemaError(f"round {message.round} is not due yet; the newest one that is due is {due}.")
        return message.to_event()

    def metrics(self) -> dict[str, Any]:
        """Return the metrics to report; of a run alone there are none."""
        trainer = self._trainer
        if not trainer.config.population.members:
            return {}
        values = hyperparameters_of(trainer.config)
        return {"round": trainer.round, "hyperparameters": values, "rounds_refused": self.refused}

    def alarms(self) -> list[str]:
        """Return a sentence if requests were refused, and one if a round is due and nobody is there to hold it."""
        found = [self._overdue()]
        if self.refused:
            found.append(f"{self.refused} rounds of the population were refused; the last one: {self._reason}")
        return [text for text in found if text]

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
