"""Whether a run's largest messages (chunks, actors, evaluations) fit into a frame; checked when the run starts."""

import math
from typing import Final

from eia_sec.common.actors import actor_parameters
from eia_sec.common.config import RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError
from eia_sec.common.protocol.frame import MAX_FRAME
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import MOST_INFOS, observation_type

ROOM: Final = 2**20
"""Bytes of a frame reserved for everything but rows and parameters."""
EPISODE_BYTES: Final = 128
"""Bytes of a finished episode without its rewards: seeds, steps and metrics."""


def chunk_bytes(config: RunConfig, environment: EnvironmentSpec) -> int:
    """Return the bytes of a worker's largest chunk, in which episodes are as short as the environment allows."""
    steps, team = config.rollout.chunk_steps, environment.team
    ends = math.ceil(steps / environment.episode_steps[0])
    kind = observation_type(team, rounded=config.bfloat16_observations)
    observation = team.observation_size * kind.itemsize
    row = observation + 4 * (team.action_size + team.agents * (2 if config.learns_on_policy else 1)) + 1
    episodes = config.rollout.environments * ends
    state = 4 * config.rollout.environments * team.agents * config.memory_size
    infos = 8 * MOST_INFOS if config.env.is_third_party else 0
    return config.rollout.chunk_rows(ends) * row + episodes * (EPISODE_BYTES + infos + 4 * team.agents) + state


def evaluation_flights(config: RunConfig) -> int:
    """Return the most episodes of an evaluation: for an imitation event, or for a round of a population."""
    wanted = (config.elite.farms if config.imitates else 0, config.population.farms if config.population.members else 0)
    return min(max(wanted), config.rollout.train_farms)


def evaluation_bytes(config: RunConfig, environment: EnvironmentSpec) -> int:
    """Return the bytes of the rewards of an evaluation; 0 where an episode's length is not known."""
    fewest, most = environment.episode_steps
    return 4 * evaluation_flights(config) * most * environment.team.agents if fewest == most else 0


def actor_bytes(config: RunConfig, team: TeamSpec) -> int:
    """Return the most bytes that all actors can take."""
    hidden, memory, module = config.algorithm.hidden, config.memory, config.module
    return 4 * sum(g.count * actor_parameters(g, hidden, "gaussian", memory, module) for g in team.groups)


def require_frames(config: RunConfig, environment: EnvironmentSpec) -> None:
    """Raise ConfigError for a run whose chunks, actors or evaluations could exceed a frame.

    Evaluations in environments whose episodes differ in length are not checked.
    """
    most, team = MAX_FRAME - ROOM, environment.team
    chunk, flights = chunk_bytes(config, environment), evaluation_bytes(config, environment)
    actors = actor_bytes(config, team)
    if chunk > most:
        raise ConfigError(
            f"a chunk of {config.rollout.environments} environments times {config.rollout.chunk_steps} steps takes up "
            f"to {chunk / 2**20:.0f} MiB with {team.agents} agents, but a message holds at most {most // 2**20} MiB; "
            "lower rollout.chunk_steps or rollout.environments."
        )
    if actors > most:
        kind, remedy = f"algorithm.hidden {config.algorithm.hidden}", "lower algorithm.hidden"
        if config.module is not None:
            kind, remedy = f"the network {config.module.name}", "make it smaller"
        raise ConfigError(
            f"{team.agents} actors with {kind} take {actors / 2**20:.0f} MiB, but a message holds at most "
            f"{most // 2**20} MiB; {remedy}."
        )
    if flights > most:
        count = evaluation_flights(config)
        raise ConfigError(
            f"the rewards of {count} flights of {environment.episode_steps[1]} steps with {team.agents} "
            f"agents take {flights / 2**20:.0f} MiB, but a message holds at most {most // 2**20} MiB; lower "
            "elite.farms or population.farms."
        )
