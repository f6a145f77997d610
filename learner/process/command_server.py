"""Answers the commands of other processes: configuration, lead, drain, arguments."""

from collections.abc import Callable
from dataclasses import replace

from eia_sec.common.clock import microseconds, monotonic
from eia_sec.common.config.environment import unusable_arguments
from eia_sec.common.errors import ProtocolError
from eia_sec.common.incarnation import LATEST, STRIDE
from eia_sec.common.log import log
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage, ConfigurationMessage, Envelope, ReceiptMessage
from eia_sec.common.transport.bus import Incoming, Server
from eia_sec.learner.process.lease import Lease

SHOWN_NAME = 64
"""Most characters of another process's name in a log line or an answer."""
MOST_NAMES = 4096
"""Most names of processes for which the number that was given out last is remembered."""


class CommandServer:
    """Answers commands.

    Args:
        server: where they come in.
        configuration: the answer to a process that joins the run.
        newest_incarnation: returns the greatest known incarnation of a worker, or 0.

    Attributes:
        lease: which coordinator leads.
        draining: whether a command asked the learner to drain.
        arguments: the environment's arguments as a callback or a command has set them, JSON, or empty.
        malformed: requests that could not be decoded.
    """

    def __init__(
        self, server: Server, configuration: ConfigurationMessage, newest_incarnation: Callable[[str], int]
    ) -> None:
        self._server, self._configuration, self._newest_incarnation = server, configuration, newest_incarnation
        self._given: dict[str, int] = {}
        self.lease, self.draining, self.arguments, self.malformed = Lease(), False, "", 0
        self._verbs: dict[str, Callable[[Incoming, CommandMessage], None]] = {
            "configuration": self._send_configuration,
            "lead": self._grant_lead,
            "drain": self._drain,
            "arguments": self._set_arguments,
        }

    def answer(self) -> None:
        """Answer every waiting command."""
        for incoming in self._server.waiting():
            try:
                command = CommandMessage.decode(incoming.payload)
                verb = keys.parse(incoming.key).variables.get("verb", "")
            except ProtocolError as error:
                self.malformed += 1
                incoming.refuse(str(error))
                continue
            if verb in self._verbs:
                self._verbs[verb](incoming, command)
            else:
                self.malformed += 1
                incoming.refuse(f"the learner has no command {verb!r}.")

    def _send_configuration(self, incoming: Incoming, command: CommandMessage) -> None:
        # An earlier start that has not delivered yet is not known, but the number that it went beyond.
        given = self._given.pop(command.sender, 0)
        newest = max(self._newest_incarnation(command.sender), min(microseconds(), LATEST), given and given + STRIDE)
        self._given[command.sender] = newest
        if len(self._given) > MOST_NAMES:
            del self._given[next(iter(self._given))]
        incoming.reply(replace(self._configuration, newest_incarnation=newest).encode())

    def _set_arguments(self, incoming: Incoming, command: CommandMessage) -> None:
        if reason := unusable_arguments(command.arguments):
            self.malformed += 1
            incoming.refuse(reason)
            return
        self.arguments = command.arguments or ""
        log(f"environments get other arguments at the request of {command.sender[:SHOWN_NAME]}.")
        incoming.reply(ReceiptMessage(True, "").encode())

    def _drain(self, incoming: Incoming, command: CommandMessage) -> None:
        log(f"draining at the request of {command.sender[:SHOWN_NAME]}.")
        self.draining = True
        incoming.reply(ReceiptMessage(True, "").encode())

    def _grant_lead(self, incoming: Incoming, command: CommandMessage) -> None:
        try:
            claimant = Envelope.decode(incoming.attachment)
        except ProtocolError as error:
            self.malformed += 1
            incoming.refuse(str(error))
            return
        granted = self.lease.claim(claimant.name, claimant.incarnation, monotonic())
        holder = self.lease.holder[0] if self.lease.holder else ""
        incoming.reply(ReceiptMessage(granted, "" if granted else f"coordinator {holder[:SHOWN_NAME]} leads.").encode())
