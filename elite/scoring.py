"""Scores each agent by the mean and variance of its rewards (omega), and picks each type's elite."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import EliteConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.team import TeamSpec


def scores(team: TeamSpec, rewards: RewardSums, config: EliteConfig) -> list[NDArray[np.float64]]:
    """Return omega of each agent, eq. (er).

    mu is the mean of the agent's step rewards R_v-i. For the variance sigma^2, step rewards are divided by the type's
    mean absolute step reward, so that beta_2 means the same for every type and throughout training.

    Args:
        team: the layout.
        rewards: of one step or more.
        config: beta_1 and beta_2.

    Returns:
        For each type, [n_v] beta_1 mu + beta_2 sigma^2.
    """
    mean, absolute, square = rewards.sums / rewards.steps
    variance = np.maximum(square - mean**2, 0.0)
    found = []
    for part in team.agent_slices():
        scale = float(absolute[part].mean())
        spread = variance[part] / scale**2 if scale > 0.0 else np.zeros_like(variance[part])
        found.append(config.weight_mean * mean[part] + config.weight_variance * spread)
    return found


def decide(
    team: TeamSpec,
    config: EliteConfig,
    event: int,
    version: int,
    episode: int,
    rewards: RewardSums,
    evaluation_steps: int = 0,
) -> ImitationEvent:
    """Return the imitation event that follows from agents' rewards.

    Args:
        team: the layout.
        config: weights and schedule.
        event: number of the event.
        version: the parameter version that earned them.
        episode: the learner's episode count when the event fell due.
        rewards: of training or of evaluation episodes.
        evaluation_steps: environment steps of these evaluation episodes.

    Raises:
        SchemaError: there are no steps.
    """
    if not rewards.steps:
        raise SchemaError("scores need at least one step.")
    omegas = scores(team, rewards, config)
    return ImitationEvent(
        event=event,
        version=version,
        episode=episode,
        rate=ImitationSchedule(config).rate(event),
        elites=tuple(int(np.argmax(omega)) for omega in omegas),
        scores=tuple(tuple(omega.tolist()) for omega in omegas),
        evaluation_steps=evaluation_steps,
    )
