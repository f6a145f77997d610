"""How many learners a run has, and where it cannot have several."""

import os
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.transport.endpoint import Endpoint

MOST_LEARNERS: Final = 64
BLOCKS: Final = 2
"""Least samples that each learner has of a minibatch, for each member of an ensemble."""
STORE: Final = "EIA_SEC_LEARNERS"
"""Environment variable with the file through which the learners of one machine find each other."""
LEADER: Final = "EIA_SEC_LEADER"
"""Environment variable with the number of the process that has started this learner to follow it."""
INTERFACE: Final = "GLOO_SOCKET_IFNAME"
"""Environment variable by which gloo chooses its network interface."""
TORCHRUN: Final = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
"""Environment variables that torchrun sets for each process."""


@dataclass(frozen=True)
class Place:
    """A learner's place in its group.

    Attributes:
        rank: its number, from 0.
        size: how many learners there are.
        store: see STORE; None for the leader, and where torchrun has started them.
        leader: number of the process that started this learner to follow it, or 0.
        by_torchrun: whether torchrun has.
    """

    rank: int
    size: int
    store: Path | None = None
    leader: int = 0
    by_torchrun: bool = False


def given_place() -> Place | None:
    """Return the place that this process's environment gives it, or None.

    Raises:
        ConfigError: a variable is impossible.
    """
    found = {name: os.environ[name] for name in TORCHRUN if name in os.environ}
    store = os.environ.get(STORE)
    if store is None and len(found) < len(TORCHRUN):
        return None
    rank, size = (found.get(name, "") for name in TORCHRUN[:2])
    if not (rank.isdecimal() and size.isdecimal() and int(rank) < int(size) <= MOST_LEARNERS):
        raise ConfigError(f"RANK={rank} and WORLD_SIZE={size} name no learner of a group of at most {MOST_LEARNERS}.")
    if store is None:
        return Place(int(rank), int(size), by_torchrun=True)
    leader = os.environ.get(LEADER, "")
    return Place(int(rank), int(size), Path(store), int(leader) if leader.isdecimal() else 0)


def chosen_place(learners: int, *, insecure: bool) -> Place:
    """Return the place that torchrun has given this process, or that of a leader of as many learners as it was told.

    Args:
        learners: `--learners`.
        insecure: whether the user allows learners to exchange rows over a network.

    Raises:
        UsageError: torchrun has started several learners, and each is to start others, or they meet on a network.
        ConfigError: the number of learners is impossible.
    """
    within(1, MOST_LEARNERS, learners=learners)
    place = given_place()
    if place is None or place.size == 1:
        return Place(0, learners)
    if learners > 1:
        raise UsageError(f"torchrun has started {place.size} learners; leave --learners out.")
    host = os.environ.get("MASTER_ADDR", "")
    if not (insecure or Endpoint("tcp", host, 1).is_loopback):
        raise UsageError(
            f"the learners that torchrun has started meet at {host}, and exchange rows and gradients without "
            "authentication or encryption; on a network of your own, allow it with --insecure."
        )
    return place


def refuse_torchrun(command: str) -> None:
    """Raise UsageError where torchrun has started several processes of a command that is no learner."""
    place = given_place()
    if place is not None and place.size > 1:
        raise UsageError(
            f"torchrun starts several eia-sec learner, not eia-sec {command}; give {command} --learners N."
        )


def meet_on_loopback(place: Place) -> None:
    """Let a group that meets on this machine listen on the loopback interface only, whatever the host's name means."""
    if not place.by_torchrun or Endpoint("tcp", os.environ.get("MASTER_ADDR", ""), 1).is_loopback:
        names = [name for _, name in socket.if_nameindex()]
        os.environ[INTERFACE] = next((name for name in names if name in ("lo", "lo0")), "lo")


def require_learners(config: RunConfig, learners: int, *, lockstep: bool) -> None:
    """Raise ConfigError where a run cannot have so many learners."""
    within(1, MOST_LEARNERS, learners=learners)
    if config.population.members and lockstep:
        raise ConfigError("a member of a population does not run in lockstep; leave --lockstep or --population out.")
    if learners == 1:
        return
    if config.population.members:
        raise ConfigError("a member of a population has one learner; leave --learners out.")
    if lockstep:
        raise ConfigError("a lockstep run has one learner; leave --learners or --lockstep out.")
    if not config.learns_on_policy:
        raise ConfigError(
            f"{config.algorithm.name} learns from a replay buffer, which one learner has; several learn on policy only."
        )
    if config.learner.device != "cpu":
        raise ConfigError(f"several learners compute on processors, not on {config.learner.device}; leave one out.")
    algorithm = config.on_policy
    if algorithm.memory != "none":
        raise ConfigError("several learners train networks without memory only; set algorithm.memory to none.")
    least = BLOCKS * learners * max(1, algorithm.ensemble_size)
    if min(algorithm.minibatch_steps, algorithm.iteration_steps) < least:
        raise ConfigError(
            f"algorithm.minibatch_steps and iteration_steps must be at least {least} for {learners} learners."
        )
