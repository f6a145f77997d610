"""Rewards that pay each visit what it turned out to be worth to the team.

A plot imaged at VDF u pays u, but if another image follows soon, most of u would have been paid to that one. The
environment knows in hindsight what each visit was worth (`eia_sec.rollout.sim.core.hindsight` has the derivation) and
keeps the correction of every step's reward in `Environments.hindsight`. Rows that learners train on hold

    r' = r + s correction

with a share s for each agent: at 0 the environment's own rewards, at 1 an agent's difference to the team. Corrections
add to shaped rewards as well (`eia_sec.rollout.worker.reward_shaping`). Episode returns and evaluations
use r, and so do elite scores with `elite.farms`; scores from training use r'.

A visit is corrected when the next visit of its plot or sensor happens. So chunks of whole episodes are exact. Where a
chunk ends before its episode, visits whose next visit lies beyond its end stay paid in full.
"""

from collections.abc import Mapping

import numpy as np

from eia_sec.common.team import Float32, TeamSpec
from eia_sec.rollout.envs.base import Environments


def shares_of(team: TeamSpec, by_type: Mapping[str, float]) -> Float32:
    """Return the share of each agent, [agents]; types that the map does not name have none."""
    return np.repeat([by_type.get(g.name, 0.0) for g in team.groups], [g.count for g in team.groups]).astype(np.float32)


def corrected(reward: Float32, correction: Float32, first: int, share: Float32) -> Float32:
    """Return the rewards of some steps of one environment's episode with a share of their corrections.

    Args:
        reward: [steps, agents] rewards.
        correction: [T, agents] corrections of the whole episode.
        first: steps of the episode before the first of these.
        share: [agents] s, 0..1.

    Returns:
        [steps, agents] r', in an array of its own.
    """
    credited: Float32 = reward + share * correction[first : first + len(reward)]
    return credited


def credit_newest(environments: Environments, index: int, reward: Float32, share: Float32) -> Float32:
    """Return the rewards of the newest steps of one environment's episode, corrected as far as known by now.

    Called once for each part of an episode in a chunk: at the episode's end, before the reset, and at the chunk's end.

    Args:
        environments: the batch.
        index: the environment.
        reward: [steps, agents] rewards of the last steps of its episode, up to the one just done.
        share: [agents] s, 0..1.

    Returns:
        [steps, agents] r'; `reward` itself where nothing is to be added.
    """
    if environments.hindsight is None or not share.any() or not len(reward):
        return reward
    first = int(environments.time[index]) - len(reward)
    return corrected(reward, environments.hindsight[index], first, share)
