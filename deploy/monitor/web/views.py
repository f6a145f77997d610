"""What a worker said that it shows: a farm, or any other environment. Checks its messages and makes packets of them."""

from typing import Final, Protocol

from eia_sec.common.config.environment import FARM
from eia_sec.common.config.files import read_saved
from eia_sec.common.config.run import RunConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.messages import StepsMessage, ViewMessage, WatchTerms
from eia_sec.common.protocol.view_checks import MAX_PARTS, MOST_AGENT_NAME, check_steps, check_view
from eia_sec.common.team import TeamSpec
from eia_sec.deploy.monitor.web import packets, steps
from eia_sec.deploy.monitor.web.packets import Packet
from eia_sec.rollout.sim.layout import make_layout

MOST_PART_NAME: Final = 32


class View(Protocol):
    """What a worker shows."""

    def scene(self, run: str, worker: str) -> Packet:
        """Return what the page needs once."""

    def frames(self, payload: bytes, version: int) -> tuple[Packet, int]:
        """Return a message's frames, and the steps that it reports as skipped.

        Raises:
            ProtocolError, ConfigError: it does not fit what was announced.
        """


def view_of(terms: WatchTerms) -> View:
    """Return what a worker shows, from its answer.

    Raises:
        SchemaError, ConfigError: the answer cannot be right.
    """
    if not (0.5 <= terms.lease_seconds <= 3600.0 and 0.0 < terms.steps_per_second <= 1e4):
        raise SchemaError("the terms of watching are out of range.")
    config = read_saved(terms.toml)
    return _Farm(config, terms) if config.env.name == FARM else _Environment(config, terms)


class _Farm:
    def __init__(self, config: RunConfig, terms: WatchTerms) -> None:
        if len(terms.part_names) > MAX_PARTS or any(len(name) > MOST_PART_NAME for name in terms.part_names):
            raise SchemaError("the parts of the reward are too many or too long.")
        self._farm, self._terms = config.farm, terms

    def scene(self, run: str, worker: str) -> Packet:
        return packets.scene(run, worker, self._farm, self._terms)

    def frames(self, payload: bytes, version: int) -> tuple[Packet, int]:
        message = ViewMessage.decode(payload)
        check_view(message, self._farm, len(self._terms.part_names))
        layout = make_layout(self._farm, message.farm)
        return packets.frames(message, self._farm, layout, version), message.skipped


class _Environment:
    def __init__(self, config: RunConfig, terms: WatchTerms) -> None:
        self._name, self._team, self._terms = config.env.name, TeamSpec.from_dict(terms.team), terms
        if len(terms.agents) != self._team.agents or any(len(name) > MOST_AGENT_NAME for name in terms.agents):
            raise SchemaError("the agents' names are not one for each agent, or too long.")

    def scene(self, run: str, worker: str) -> Packet:
        return steps.scene(run, worker, self._name, self._team, self._terms)

    def frames(self, payload: bytes, version: int) -> tuple[Packet, int]:
        message = StepsMessage.decode(payload)
        check_steps(message, self._team)
        return steps.frames(message, version), message.skipped
