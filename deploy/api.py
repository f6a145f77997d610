"""The four functions that `eia_sec` itself offers: train, evaluate, load a policy, make an environment.

Everything runs in the calling process, on one core and without a network. `eia-sec train` does the same with processes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eia_sec.common import policy_file
from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_of
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.rollout import evaluation
from eia_sec.rollout.envs.parallel_env import FarmParallelEnv, parallel_env
from eia_sec.rollout.policies import ActorPolicy, run_policy
from eia_sec.rollout.shipped_policies import policy_path, preset_of

Settings = Mapping[str, Any]


def train(config: str | RunConfig = "default", settings: Settings | None = None) -> TeamActors:
    """Train and return the policy, without its exploration noise.

    The same configuration gives the same weights, bit for bit, and so does `eia-sec train --lockstep`.

    Args:
        config: name of a preset, or a whole configuration.
        settings: what differs from it, by dotted names as after `--set`: `{"episodes": 200, "seed": 1}`.

    Raises:
        ConfigError: the configuration is impossible.
    """
    return train_in_process(_run(config, settings)).actors().noise_free()


def evaluate(
    policy: str | Path | TeamActors,
    config: str | RunConfig | None = None,
    *,
    settings: Settings | None = None,
    farms: Sequence[int] = range(1000, 1020),
    episodes: int = 1,
) -> evaluation.Evaluation:
    """Run a policy without noise on farms that training never uses, and return its scores.

    Args:
        policy: what `train` or `load_policy` returned, a policy file, or the name of a policy or heuristic.
        config: preset or configuration of the environment; by default that of the named policy, otherwise `default`.
        settings: what differs from it, as for `train`.
        farms: seeds of the farms, or of the scenarios of another environment.
        episodes: episodes on each.

    Raises:
        ConfigError: the configuration is impossible, or there is nothing to evaluate on.
        PolicyError: the policy does not exist, or does not fit the environment.
    """
    name = "policy" if isinstance(policy, TeamActors) else str(policy)
    run = _run(config or preset_of(name), settings)
    chosen = ActorPolicy(policy) if isinstance(policy, TeamActors) else run_policy(name, run)
    return evaluation.evaluate_run(run, chosen, farms, episodes, name=name)


def load_policy(policy: str | Path) -> TeamActors:
    """Return a trained policy from its file, or by its name: `trained`, `trained:long`, ...

    `policy.environment_actions(observations[None])` are its actions [1, A] for the observations of all agents [O] in
    the order of `possible_agents`.

    Raises:
        PolicyError: there is no such file, or it is damaged.
    """
    actors, _ = policy_file.load_policy(policy_path(str(policy)))
    return actors


def make_env(
    config: str | RunConfig = "default", settings: Settings | None = None, *, render_mode: str | None = None
) -> FarmParallelEnv:
    """Return the farm as a PettingZoo `ParallelEnv`.

    Args:
        config: preset or configuration.
        settings: what differs from it, as for `train`.
        render_mode: "rgb_array", "ansi", "human", or none.

    Raises:
        ConfigError: the farm is impossible, the environment is another one, or the mode does not exist.
    """
    run = _run(config, settings)
    farm = farm_of(run)
    if farm is None:
        raise ConfigError(f"make_env makes farms, and this configuration is for {run.env.name}.")
    return parallel_env(farm, render_mode=render_mode)


def _run(config: str | RunConfig, settings: Settings | None) -> RunConfig:
    return with_values(preset(config) if isinstance(config, str) else config, dict(settings or {}))
