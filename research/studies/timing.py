"""Milliseconds that the UAVs' decisions take at each time step, M4 and M5, with one thread."""

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from eia_sec.common.actions.sampling import best_options
from eia_sec.common.actors import TeamActors, actor_outputs, parameter_views
from eia_sec.common.config import RunConfig
from eia_sec.common.team import Float32
from eia_sec.learner.registry import OFF_POLICY
from eia_sec.rollout.sim.batch import FarmBatch

WARM_STEPS: Final = 50
"""Steps before the clock counts."""


def time_decisions(config: RunConfig, steps: int) -> dict[str, Any]:
    """Time the decisions of a team on farms, with actors that nothing has trained.

    What an actor computes does not depend on the values of its weights, and execution needs no critic, no ensemble and
    no imitation; so neither training nor these parts change the time.

    Args:
        config: the run; its seed gives the weights, its algorithm the actors' last layer.
        steps: time steps.

    Returns:
        For each of three pieces of a time step 5 % quantile, median, mean and 95 % quantile, ms: `decide`, all UAVs
        from observation to action, stacked as this project flies them; `separate`, the same actions from one torch
        network after another, as most implementations do; `simulate`, the simulator's step with assignment, rewards
        and observations.
    """
    batch = FarmBatch(config.farm, 1)
    actors = TeamActors.initial(
        batch.team, config.algorithm.hidden, config.seed, head=OFF_POLICY[config.algorithm.name].head
    )
    separate, flat = separate_actors(actors), np.empty((1, batch.team.environment_action_size), np.float32)
    pieces: dict[str, list[float]] = {"decide": [], "separate": [], "simulate": []}
    for step in range(steps + WARM_STEPS):
        if step % config.farm.world.steps == 0:
            batch.reset(0, step // config.farm.world.steps, config.seed)
        counts = step >= WARM_STEPS
        flat[...] = _clocked(lambda: actors.environment_actions(batch.observation), pieces["decide"], counts)
        _clocked(lambda: separate(batch.observation), pieces["separate"], counts)
        _clocked(lambda: batch.step(flat), pieces["simulate"], counts)
    return {name: _summary(np.array(milliseconds)) for name, milliseconds in pieces.items()}


def separate_actors(actors: TeamActors) -> Callable[[Float32], Float32]:
    """Return a function that computes the noise-free actions [1, A] with one torch network after another."""
    networks: list[nn.Sequential] = []
    for group, flat in zip(actors.team.groups, actors.flat, strict=True):
        outputs = actor_outputs(group, actors.head)
        views = parameter_views(flat, group.observation_size, actors.hidden, outputs)
        for agent in range(len(flat)):
            layers: list[nn.Module] = []
            for weight, bias in zip(views[::2], views[1::2], strict=True):
                layer = nn.Linear(weight.shape[1], weight.shape[2])
                layer.weight.data = torch.from_numpy(np.ascontiguousarray(weight[agent].T))
                layer.bias.data = torch.from_numpy(bias[agent].copy())
                layers += [layer, nn.ReLU()]
            networks.append(nn.Sequential(*layers[:-1]))
        networks += networks[-1:] * (group.count - len(flat))  # agents that share their parameters share a network

    def act(observation: Float32) -> Float32:
        parts = actors.team.split_observations(observation)
        rows = [group_rows[0, agent] for group_rows in parts for agent in range(group_rows.shape[1])]
        kinds = [group for group in actors.team.groups for _ in range(group.count)]
        with torch.no_grad():
            actions = []
            for group, row, network in zip(kinds, rows, networks, strict=True):
                output = network(torch.from_numpy(row))
                chosen = best_options(group, row, output.numpy()) if group.choices else None
                actions.append(torch.tanh(output[: group.action_size]).numpy() if chosen is None else chosen)
        return actors.team.adapt(observation, np.concatenate(actions)[None])

    return act


def _clocked(work: Callable[[], Any], milliseconds: list[float], counts: bool) -> Any:
    start = time.perf_counter()
    found = work()
    if counts:
        milliseconds.append(1e3 * (time.perf_counter() - start))
    return found


def _summary(milliseconds: NDArray[np.float64]) -> dict[str, float]:
    return {
        "q05": round(float(np.quantile(milliseconds, 0.05)), 5),
        "median": round(float(np.median(milliseconds)), 5),
        "mean": round(float(milliseconds.mean()), 5),
        "q95": round(float(np.quantile(milliseconds, 0.95)), 5),
    }
