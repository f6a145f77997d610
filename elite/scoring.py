"""Scores each agent by the mean and variance of its rewards (omega), and picks each type's elite."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import EliteConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.team import Float32, TeamSpec


def scores(reward: Float32, config: EliteConfig) -> NDArray[np.float64]:
    """Return omega of each agent of one type, eq. (er).

    mu is the mean of the agent's step rewards R_v-i. For the variance sigma^2, step rewards are divided by the type's
    mean absolute step reward, so that beta_2 means the same for every type and throughout training.

    Args:
        reward: [..., n_v] step rewards of noise-free episodes.
        config: beta_1 and beta_2.

    Returns:
        [n_v] beta_1 mu + beta_2 sigma^2.
    """
    steps = reward.astype(np.float64).reshape(-1, reward.shape[-1])
    scale = float(np.abs(steps).mean())
    variance = (steps / scale).var(axis=0) if scale > 0 else np.zeros(steps.shape[1])
    return np.asarray(config.weight_mean * steps.mean(axis=0) + config.weight_variance * variance)


def decide(
    team: TeamSpec, config: EliteConfig, event: int, version: int, episode: int, rewards: Sequence[Float32]
) -> ImitationEvent:
    """Return the imitation event that follows from an evaluation.

    Args:
        team: the layout.
        config: weights and schedule.
        event: number of the event.
        version: the parameter version that was evaluated.
        episode: the learner's episode count when the event fell due.
        rewards: [T, agents] step rewards of each episode.

    Raises:
        SchemaError: when the rewards do not fit the team or are not finite.
    """
    for reward in rewards:
        if reward.ndim != 2 or reward.shape[1] != team.agents or len(reward) == 0 or not np.isfinite(reward).all():
            raise SchemaError(f"an episode of shape {list(reward.shape)} does not fit {team.agents} agents.")
    if len(rewards) == 0:
        raise SchemaError("an evaluation needs at least one episode.")
    steps = np.concatenate(rewards)
    omegas = [scores(steps[:, part], config) for part in team.agent_slices()]
    return ImitationEvent(
        event=event,
        version=version,
        episode=episode,
        rate=ImitationSchedule(config).rate(event),
        elites=tuple(int(np.argmax(omega)) for omega in omegas),
        scores=tuple(tuple(omega.tolist()) for omega in omegas),
        evaluation_steps=len(steps),
    )
