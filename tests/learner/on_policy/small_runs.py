"""A small team with discrete and continuous actions, its experience, and runs that learn from it."""

from dataclasses import replace
from typing import Any

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import ALGORITHM_CONFIGS, OnPolicyConfig, RunConfig
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows

TEAM = TeamSpec((GroupSpec("a", 2, 8, 2, choices=(2, 3), masked=True), GroupSpec("b", 3, 2, 2)))
"""Type a chooses one of two and one of three options, some of them illegal; type b has continuous actions."""
OPTIONS = 5
ALGORITHMS = {name: kind for name, kind in ALGORITHM_CONFIGS.items() if issubclass(kind, OnPolicyConfig)}
TINY: dict[str, Any] = {
    "hidden": 8,
    "objective": "ppo",
    "iteration_steps": 40,
    "minibatch_steps": 10,
    "precision": "float32",
    "reward_scale": 1.0,
    "discounts": {"b": 0.5},
    "entropy_scales": {"b": 0.25},
}


def configured(name: str = "ippo", **options: Any) -> RunConfig:
    """Return a run of ten episodes; agents that imitate have networks of their own from the beginning."""
    separate = {"shared_until": 0.0} if name == "eia-ppo" else {}
    return RunConfig(seed=5, episodes=10, algorithm=ALGORITHMS[name](**{**TINY, **separate, **options}))


def observations(team: TeamSpec, count: int, draw: np.random.Generator) -> Float32:
    """Return rows of observations; masks allow at least one option of each branch."""
    rows = draw.normal(size=(count, team.observation_size)).astype(np.float32)
    for group, own in zip(team.groups, team.split_observations(rows), strict=True):
        if group.masked:
            legal = draw.random((*own.shape[:-1], group.options)) < 0.6
            start = 0
            for options in group.choices:
                allowed = draw.integers(start, start + options, own.shape[:-1])
                np.put_along_axis(legal, allowed[..., None], True, axis=-1)
                start += options
            own[..., -group.options :] = legal
    return rows


def moved(actors: TeamActors, scale: float, draw: np.random.Generator) -> TeamActors:
    """Return other actors near these."""
    flat = tuple(own + np.float32(scale) * draw.standard_normal(own.shape, np.float32) for own in actors.flat)
    return replace(actors, flat=flat)


def sampled(actors: TeamActors, rows: Float32, draw: np.random.Generator) -> tuple[Float32, Float32]:
    """Return actions that the actors sample, and their log-probabilities."""
    shape = len(rows), actors.team.action_size
    return actors.sample(rows, draw.standard_normal(shape, np.float32), draw.random(shape, np.float32))


def chunk(
    actors: TeamActors, seed: int, segments: tuple[tuple[int, int], ...] = ((20, 0),), episodes: int = 0
) -> Chunk:
    """Return a chunk of segments of (steps, flag of the last step) that the actors flew in random observations."""
    draw = np.random.default_rng(seed)
    flag = np.concatenate([[TRANSITION] * (steps - 1) + [TRANSITION | end, 0] for steps, end in segments])
    observation = observations(actors.team, len(flag), draw)
    action, log_probability = sampled(actors, observation, draw)
    reward = draw.normal(1.0, 2.0, (len(flag), actors.team.agents)).astype(np.float32)
    for array in (action, log_probability, reward):
        array[flag == 0] = 0.0
    rows = Rows(observation, action, reward, flag.astype(np.uint8), log_probability)
    rows.check(actors.team)
    done = tuple(EpisodeSummary(n, n, 20, (0.0,) * actors.team.agents, {"energy_j": 1.0}) for n in range(episodes))
    return Chunk(rows, done)


ENDS = ((17, TRUNCATED), (12, 0), (11, TERMINATED))
"""Segments of 40 steps, one of every kind."""
