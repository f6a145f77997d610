"""Applies what the coordinator of a population sends after each round."""

from collections.abc import Callable, Mapping
from typing import Any

from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.population import Exploit, hyperparameters_of, round_due
from eia_sec.common.protocol.messages import Envelope, ExploitMessage, ReceiptMessage
from eia_sec.common.transport.bus import Incoming, Server
from eia_sec.learner.process.imitation_server import LONGEST_REASON
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.trainer import Trainer


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
        """Return a sentence if requests were refused."""
        if not self.refused:
            return []
        return [f"{self.refused} rounds of the population were refused; the last one: {self._reason}"]
