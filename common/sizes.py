"""Whether a run's largest messages fit into a frame, told before anything is started."""

from typing import Final

from common.actors import head_outputs, parameter_count
from common.config import RunConfig
from common.errors import ConfigError
from common.frame import MAX_FRAME
from common.team import TeamSpec

ROOM: Final = 2**20
"""Bytes of a frame that are left for what stands beside rows and parameters."""
EPISODE_BYTES: Final = 128
"""Bytes of a finished episode beside its rewards: seeds, steps and figures."""


def chunk_bytes(config: RunConfig, team: TeamSpec) -> int:
    """Return the bytes of a worker's largest chunk: every step may end an episode."""
    row = 4 * (team.observation_size + team.action_size + team.agents) + 1
    rows = config.rollout.chunk_rows
    return rows * row + rows // 2 * (EPISODE_BYTES + 4 * team.agents)


def actor_bytes(config: RunConfig, team: TeamSpec) -> int:
    """Return the bytes of all actors, at most."""
    sizes = ((g.count, g.observation_size, head_outputs(g.action_size, "gaussian")) for g in team.groups)
    return 4 * sum(
        count * parameter_count(inputs, config.algorithm.hidden, outputs) for count, inputs, outputs in sizes
    )


def require_frames(config: RunConfig, team: TeamSpec) -> None:
    """Raise ConfigError for a run whose workers could not deliver a chunk, or be sent the actors."""
    most = MAX_FRAME - ROOM
    chunk, actors = chunk_bytes(config, team), actor_bytes(config, team)
    if chunk > most:
        raise ConfigError(
            f"a chunk of {config.rollout.environments} environments times {config.rollout.chunk_steps} steps takes up "
            f"to {chunk / 2**20:.0f} MiB with {team.agents} agents, a message at most {most // 2**20}; lower "
            "rollout.chunk_steps or rollout.environments."
        )
    if actors > most:
        raise ConfigError(
            f"{team.agents} actors with algorithm.hidden {config.algorithm.hidden} take {actors / 2**20:.0f} MiB, a "
            f"message at most {most // 2**20}; lower algorithm.hidden."
        )
