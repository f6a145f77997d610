"""Environments that others serve, as a worker sees them: each is a PettingZoo parallel environment."""

import fnmatch
import random
import secrets
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from eia_sec.common.errors import BusError, EnvironmentOutageError, ProtocolError, SchemaError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.environment_messages import DONE, MOST_COPIES, ClaimAnswer, ClaimRequest, LeaseRequest
from eia_sec.common.protocol.environment_values import Box, form_of
from eia_sec.common.text import printable
from eia_sec.rollout.envs.base import Reach
from eia_sec.rollout.envs.guard import Ahead
from eia_sec.rollout.remote.lease import COUNTS, Agents, Lease

CLAIM_SECONDS: Final = 5.0
"""Time that an environment has to answer a claim."""
MOST_AGENTS: Final = 4096
MOST_ANSWER: Final = 256 * 1024 * 1024
"""Most bytes that a step of all copies may take and bring."""
LONGEST_LEASE: Final = 3600.0
"""Longest time that a lease may last without being renewed, s."""


class ServedEnvironments:
    """The served environments that one batch uses.

    Args:
        reach: how to reach them.
        pattern: their names; `*` stands for any letters.
    """

    def __init__(self, reach: Reach, pattern: str) -> None:
        self._reach, self._pattern = reach, pattern
        self._leases: list[Lease] = []
        self._described: dict[str, Any] = {}

    def make(self, **keywords: Any) -> "ServedEnvironment":
        """Return one that is free; raise EnvironmentOutageError if none is."""
        if keywords:
            raise TypeError(f"a served environment takes no arguments, and these were given: {', '.join(keywords)}")
        return ServedEnvironment(self)

    @property
    def description(self) -> dict[str, Any]:
        """What the first claimed environment said of its agents and spaces, which all others must equal."""
        return self._described

    def place(self) -> tuple[Lease, int]:
        """Return a free copy, of an environment held already or else of another one.

        Raises:
            EnvironmentOutageError: there is none.
        """
        self._leases = [lease for lease in self._leases if not lease.lost]
        for lease in self._leases:
            if lease.free:
                return lease, lease.free.pop(0)
        lease = self._claim()
        self._leases.append(lease)
        return lease, lease.free.pop(0)

    def leave(self, lease: Lease, copy: int) -> None:
        """Give a copy back, and with its last one the environment."""
        lease.free.append(copy)
        if len(lease.free) == lease.copies:
            lease.release()

    def send(self) -> None:
        """Send all orders, so that environments move at the same time."""
        for lease in self._leases:
            lease.send()

    def _claim(self) -> Lease:
        held = {lease.name for lease in self._leases}
        names = [name for name in self._names() if name not in held]
        said = []
        for name in random.sample(names, len(names)):
            try:
                return self._claim_one(name)
            except (BusError, ProtocolError) as error:
                said.append(printable(f"{name}: {error}"))
        if not names:
            other = f" but {len(held)} that this process holds" if held else ""
            raise EnvironmentOutageError(f"no environment called {self._pattern} is served{other}")
        raise EnvironmentOutageError(f"none of {len(names)} environments called {self._pattern} is free ({said[0]})")

    def _names(self) -> list[str]:
        found = []
        for key in self._reach.bus.living(keys.ENVIRONMENT_LIVE.pattern()):
            with suppress(ProtocolError):
                name = keys.parse(key).variables["environment"]
                if fnmatch.fnmatchcase(name, self._pattern):
                    found.append(name)
        return sorted(set(found))

    def _claim_one(self, name: str) -> Lease:
        """Return a lease; raise BusError or ProtocolError with a sentence if there is none to be had."""
        bus, key = self._reach.bus, keys.ENVIRONMENT.key(environment=name, verb="claim")
        request = ClaimRequest(self._reach.holder, secrets.randbits(62))
        data = bus.request(key, request.encode(), CLAIM_SECONDS).answer()
        if data is None:
            raise SchemaError(f"it has not answered within {CLAIM_SECONDS:.0f} s.")
        granted = ClaimAnswer.decode(data)
        if granted.status != DONE:
            raise SchemaError(granted.reason)
        try:
            agents = agents_of(granted)
            described = {
                "agents": granted.agents,
                "observation_spaces": granted.observation_spaces,
                "action_spaces": granted.action_spaces,
            }
            if self._described and described != self._described:
                raise SchemaError("it has other agents or spaces than the one before.")
        except SchemaError:
            COUNTS.refused += 1
            back = LeaseRequest(granted.incarnation, granted.lease).encode()
            bus.request(keys.ENVIRONMENT.key(environment=name, verb="release"), back, CLAIM_SECONDS)
            raise
        self._described = described
        return Lease(bus, name, granted, agents)


class ServedEnvironment(Ahead, ParallelEnv[str, Any, Any]):  # type: ignore[misc]  # PettingZoo ships no types
    """One copy of a served environment; after an outage, a reset may find another one.

    Args:
        served: where to find one.

    Raises:
        EnvironmentOutageError: none is free.
    """

    metadata: Final = {"name": "served"}

    def __init__(self, served: ServedEnvironments) -> None:
        self._served = served
        self._place: tuple[Lease, int] | None = served.place()
        found = served.description
        self.possible_agents = list(found["agents"])
        self.agents: list[str] = []
        names = self.possible_agents
        self.observation_spaces = {n: space_of(s) for n, s in zip(names, found["observation_spaces"], strict=True)}
        self.action_spaces = {n: space_of(s) for n, s in zip(names, found["action_spaces"], strict=True)}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return an agent's observation space."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return an agent's action space."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, Any]:
        """Begin an episode."""
        if self._place is None or self._place[0].lost:
            self._place = self._served.place()
        self._order(secrets.randbits(31) if seed is None else int(seed))
        moved = self._take()
        return moved["observations"], moved["infos"]

    def ahead(self, actions: Mapping[Any, Any]) -> None:
        """Note the actions of a step that is to follow."""
        self._order(dict(actions))

    def step(self, actions: Mapping[str, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Make the step whose actions were noted."""
        moved = self._take()
        return tuple(moved[part] for part in ("observations", "rewards", "terminations", "truncations", "infos"))

    def close(self) -> None:
        """Give the copy back."""
        if self._place is not None:
            self._served.leave(*self._place)
            self._place = None

    def _order(self, order: Any) -> None:
        assert self._place is not None
        lease, copy = self._place
        lease.order(copy, order)

    def _take(self) -> dict[str, Any]:
        assert self._place is not None
        lease, copy = self._place
        self._served.send()
        moved = lease.take(copy)
        self.agents = moved["agents"]
        return moved


def agents_of(granted: ClaimAnswer) -> Agents:
    """Return the agents that a claim's answer describes.

    Raises:
        SchemaError: the description cannot be used.
    """
    names, seen, acts = granted.agents, granted.observation_spaces, granted.action_spaces
    if not 0 < len(names) <= MOST_AGENTS or not all(isinstance(name, str) and name for name in names):
        raise SchemaError(f"it names no agents, or more than {MOST_AGENTS}.")
    if len(set(names)) != len(names) or not len(names) == len(seen) == len(acts):
        raise SchemaError("it does not give each agent one name and two spaces.")
    if not 0 < granted.copies <= MOST_COPIES or not 0.0 < granted.lease_seconds <= LONGEST_LEASE:
        raise SchemaError(f"it has no copies, too many, or no lease of at most {LONGEST_LEASE:.0f} s.")
    agents = Agents(
        tuple(names),
        {name: form_of(space) for name, space in zip(names, seen, strict=True)},
        {name: form_of(space) for name, space in zip(names, acts, strict=True)},
    )
    sizes = agents.most_answer + sum(form.most for form in agents.acts.values())
    if granted.copies * sizes > MOST_ANSWER:
        raise SchemaError(f"a step of all its copies would take or bring more than {MOST_ANSWER // 2**20} MiB.")
    return agents


def space_of(description: dict[str, Any]) -> spaces.Space[Any]:
    """Return the Gymnasium space of a description that `form_of` has accepted."""
    kind, form = description["type"], form_of(description)
    if kind == "box":
        assert isinstance(form, Box)
        low, high = form.bounds()
        return spaces.Box(low, high, form.shape, form.dtype.type)
    if kind == "discrete":
        return spaces.Discrete(description["n"], start=description["start"])
    if kind == "multi_discrete":
        return spaces.MultiDiscrete(np.array(description["nvec"]), start=np.array(description["start"]))
    if kind == "multi_binary":
        shape = description["shape"]
        return spaces.MultiBinary(shape[0] if len(shape) == 1 else shape)
    if kind == "tuple":
        return spaces.Tuple([space_of(part) for part in description["spaces"]])
    return spaces.Dict([(key, space_of(part)) for key, part in description["spaces"]])


def copies_of(reach: Reach, pattern: str) -> int:
    """Return how many copies a free environment of this name has; raise EnvironmentOutageError if none is free."""
    served = ServedEnvironments(reach, pattern)
    lease, copy = served.place()
    served.leave(lease, copy)
    return lease.copies
