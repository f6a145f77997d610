"""Updates over drawn batches: n steps and running statistics, beside the oracle with both done by plain loops."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Rows
from eia_sec.learner.off_policy.engine import Batch
from eia_sec.learner.off_policy.replay import Replay
from tests.learner.off_policy.test_engine import BASE, TEAM, differences, twins

STEPS = 3
LENGTHS = (2, 9, 1, 30, 4)


def recorded(draw):
    """Return rows of five episodes, whose rewards are such that float32 sums of their discounted ones are exact."""
    flags = []
    for length in LENGTHS:
        flags += [TRANSITION] * (length - 1) + [TRANSITION | int(draw.choice([TERMINATED, TRUNCATED])), 0]
    count = len(flags)
    return Rows(
        draw.normal(2.0, 3.0, (count, TEAM.observation_size)).astype(np.float32),
        draw.uniform(-1.0, 1.0, (count, TEAM.action_size)).astype(np.float32),
        (draw.integers(-64, 65, (count, TEAM.agents)) / 16.0).astype(np.float32),
        np.array(flags, np.uint8),
    )


def joined(chunks):
    names = ("observation", "action", "reward", "flag")
    return Rows(*(np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in names))


def statistics(rows, sizes):
    """Return mean and standard deviation [all columns] of a type's agents together, column by column of one agent."""
    means, stds, start = [], [], 0
    for group, size in zip(TEAM.groups, sizes, strict=True):
        part = rows[:, start : start + group.count * size].reshape(-1, size)
        means += [part.mean(axis=0)] * group.count
        stds += [np.maximum(part.std(axis=0), 1e-2)] * group.count
        start += group.count * size
    return np.concatenate(means), np.concatenate(stds)


def stretched(rows, start, discount):
    """Return the sum of the rewards from a row on, the row that follows, whether that ends all, and the discount."""
    total, weight, row = np.zeros(TEAM.agents), 1.0, start
    for _ in range(STEPS):
        total += weight * rows.reward[row]
        weight *= discount
        row += 1
        if not rows.flag[row] & TRANSITION:
            break
    return total, row, bool(rows.flag[row - 1] & TERMINATED), weight


def plain_batch(rows, places, discount):
    """Return the batch of these places in float64, standardised by all rows from which a step follows."""
    follows = (rows.flag & TRANSITION) != 0
    mean, std = statistics(rows.observation[follows].astype(np.float64), [g.observation_size for g in TEAM.groups])
    _, paid = statistics(rows.reward[follows].astype(np.float64), [1] * len(TEAM.groups))
    reward, following, ends, weight = zip(*(stretched(rows, place, discount) for place in places), strict=True)
    parts = (
        (rows.observation[places] - mean) / std,
        rows.action[places].astype(np.float64),
        np.stack(reward) / paid,
        (rows.observation[list(following)] - mean) / std,
        np.array(ends, np.float64),
        np.array(weight),
    )
    return Batch(*(torch.from_numpy(part) for part in parts))


@pytest.mark.parametrize("scope", ["local", "joint"])
def test_fifty_updates_equal_the_loop_over_agents(scope):
    """Rewards of three steps, observations and rewards by statistics that move: what the plain loops come to."""
    config = replace(
        BASE,
        critic_scope=scope,
        discount=0.5,
        n_step=STEPS,
        gradient_clip=0.5,
        observation_normalisation=True,
        reward_normalisation=True,
    )
    engine, oracle = twins(TEAM, config)
    replay = Replay(TEAM, 1000, steps=STEPS, discount=config.discount)
    draw = np.random.default_rng(2)
    chunks = []
    for number in range(50):
        if number % 10 == 0:
            chunks.append(recorded(draw))
            follows = (chunks[-1].flag & TRANSITION) != 0
            replay.add(chunks[-1], 0)
            engine.observe(chunks[-1].observation[follows], chunks[-1].reward[follows])
            rows = joined(chunks)
        drawn = replay.sample(config.batch, draw)
        engine.update(Batch(*(tensor.double() for tensor in drawn)))
        oracle.update(plain_batch(rows, replay.drawn_places, config.discount))
    for name, gap in differences(engine, oracle):
        assert gap < 1e-9, f"{name} differ by {gap}"
