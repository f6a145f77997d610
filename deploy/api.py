"""The functions that `eia_sec` itself offers: train, evaluate, load a policy, make an environment."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from eia_sec.common import plugins as plugin_registry
from eia_sec.common import policy_file
from eia_sec.common.callbacks import Callback, require_callbacks
from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.environment import FARM, EnvConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.plugin_names import PluginNames
from eia_sec.common.config.presets import preset as preset_named
from eia_sec.common.config.presets import preset_for
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_of
from eia_sec.deploy.local.run_directory import new_folder
from eia_sec.deploy.python.environment_name import environment_name
from eia_sec.deploy.python.run import Run, without_timeout
from eia_sec.deploy.python.training import train_elsewhere, train_here
from eia_sec.rollout import evaluation
from eia_sec.rollout.agent_policy import Policy
from eia_sec.rollout.envs.parallel_env import FarmParallelEnv, parallel_env
from eia_sec.rollout.envs.registry import require_known
from eia_sec.rollout.policies import ActorPolicy, run_policy
from eia_sec.rollout.shipped_policies import policy_path, preset_of

Settings = Mapping[str, Any]


def train(
    environment: str | Callable[..., Any] | RunConfig = FARM,
    *,
    algorithm: str = "",
    preset: str = "",
    seed: int | None = None,
    steps: int = 0,
    episodes: int = 0,
    workers: int = 0,
    settings: Settings | None = None,
    callbacks: Sequence[Callback] = (),
    plugins: Sequence[str] = (),
    run_dir: str | Path | None = None,
    connect: str | None = None,
    run: str = "",
) -> Run:
    """Train a policy, and return the run with it.

    It works in a script, a notebook and a thread. With `workers=0` everything runs in this process, on one core, and
    the same configuration gives the same weights, bit for bit, as with `eia-sec train --lockstep`. Otherwise learner,
    coordinator and workers are processes of their own, as with `eia-sec train`. Ctrl-C then drains the run, which can
    be resumed, and raises KeyboardInterrupt.

    Args:
        environment: `farm`, module:name of a PettingZoo parallel environment, a class or a function that makes one, or
            a whole configuration.
        algorithm: name of the algorithm; by default that of the preset.
        preset: what to begin from; by default `inertial` for the farm and `generic` for any other environment.
        seed: of the run.
        steps: environment steps that end the run; by default as the preset says.
        episodes: training episodes that end the run; with both, the first that is reached.
        workers: rollout processes on this machine; 0 trains in this process.
        settings: what differs besides, by dotted names as after `--set`: `{"algorithm.hidden": 128}`.
        callbacks: called while it trains, see `eia_sec.Callback`.
        plugins: names of plug-ins to load, as `--plugin` takes them; their callbacks are called, too.
        run_dir: run directory, new or empty, for configuration, metrics and policy, and with workers for checkpoints
            and logs. By default none in this process, and with workers runs/PRESET-TIME.
        connect: endpoint of a router, `tcp/host:7447` for one, through which workers of other machines join.
        run: name of the run, by which they join; needed with `connect`.

    Raises:
        UsageError: something is impossible; the message is one sentence.
        EiaSecError: a process has failed for good.
    """
    require_callbacks(callbacks)
    within(0, 1024, workers=workers)
    if connect is not None and not run:
        raise ConfigError("connect needs run, the name by which workers of other machines join.")
    given = environment.plugins if isinstance(environment, RunConfig) else ()
    _load((*given, *_names(plugins)))
    elsewhere = workers > 0 or connect is not None
    chosen = _whole(environment, preset, elsewhere=elsewhere)
    if algorithm:
        chosen = chosen.with_algorithm(algorithm)
    budget = {name: value for name, value in (("steps", steps), ("episodes", episodes)) if value}
    own: dict[str, Any] = budget | ({} if seed is None else {"seed": seed})
    config = with_values(with_values(chosen, dict(settings or {})), own)
    network = None if config.module is None else config.module.name
    used = (*given, *plugins, *plugin_registry.owners(config.algorithm.name, network))
    config = replace(config, plugins=PluginNames(dict.fromkeys(used)))
    folder = None if run_dir is None else Path(run_dir)
    if not elsewhere:
        return train_here(config, folder, [*callbacks, *plugin_registry.callbacks(config.plugins)])
    if folder is None:
        named = preset or (preset_for(config.env.name) if not isinstance(environment, RunConfig) else "train")
        folder = new_folder(Path("runs"), f"{named}-{time.strftime('%Y%m%d-%H%M%S')}")
    return train_elsewhere(config, folder, callbacks, workers, connect, run or "train")


def evaluate(
    policy: str | Path | Policy,
    environment: str | Callable[..., Any] | RunConfig = "",
    *,
    preset: str = "",
    settings: Settings | None = None,
    farms: Sequence[int] = range(1000, 1020),
    episodes: int = 1,
    plugins: Sequence[str] = (),
) -> evaluation.Evaluation:
    """Run a policy without noise on farms that training never uses, and return its scores.

    Args:
        policy: what `load_policy` returned or `Run.policy` is, a policy file, or the name of a policy or heuristic.
        environment: as for `train`; by default the farm.
        preset: likewise; by default that of the named policy.
        settings: what differs from it, as for `train`.
        farms: seeds of the farms, or of the scenarios of another environment.
        episodes: episodes on each.
        plugins: names of plug-ins to load, as `--plugin` takes them.

    Raises:
        ConfigError: the configuration is impossible, or there is nothing to evaluate on.
        PolicyError: the policy does not exist, or does not fit the environment.
    """
    _load(_names(plugins))
    name = "policy" if isinstance(policy, Policy) else str(policy)
    config = _whole(environment or FARM, preset or ("" if environment else preset_of(name)), elsewhere=False)
    config = with_values(config, dict(settings or {}))
    chosen = ActorPolicy(policy.actors) if isinstance(policy, Policy) else run_policy(name, config)
    return evaluation.evaluate_run(without_timeout(config), chosen, farms, episodes, name=name)


def load_policy(
    policy: str | Path, environment: str | Callable[..., Any] | EnvConfig = FARM, *, plugins: Sequence[str] = ()
) -> Policy:
    """Return a trained policy from its file, or by its name: `trained`, `trained:long`, ...

    Args:
        policy: the file, or the name.
        environment: the environment that it acts in, as for `train`, for whoever calls `Policy.act` with what a
            PettingZoo environment returns. For the farm it is not needed.
        plugins: names of plug-ins to load, as `--plugin` takes them.

    Raises:
        ConfigError: there is no such environment.
        PolicyError: there is no such file, or it is damaged.
    """
    _load(_names(plugins))
    actors, _ = policy_file.load_policy(policy_path(str(policy)))
    found = environment if isinstance(environment, EnvConfig) else EnvConfig(_named(environment, elsewhere=False))
    require_known(found)
    return Policy(actors, found)


def make_env(
    config: str | RunConfig = "inertial", settings: Settings | None = None, *, render_mode: str | None = None
) -> FarmParallelEnv:
    """Return the farm as a PettingZoo `ParallelEnv`.

    Args:
        config: preset or configuration.
        settings: what differs from it, as for `train`.
        render_mode: "rgb_array", "ansi", "human", or none.

    Raises:
        ConfigError: the farm is impossible, the environment is another one, or the mode does not exist.
    """
    run = with_values(preset_named(config) if isinstance(config, str) else config, dict(settings or {}))
    farm = farm_of(run)
    if farm is None:
        raise ConfigError(f"make_env makes farms, and this configuration is for {run.env.name}.")
    return parallel_env(farm, render_mode=render_mode)


def _whole(environment: str | Callable[..., Any] | RunConfig, preset: str, *, elsewhere: bool) -> RunConfig:
    """Return the configuration that a program begins from."""
    if isinstance(environment, RunConfig):
        return environment
    name = _named(environment, elsewhere=elsewhere)
    return preset_named(preset or preset_for(name)).with_environment(name)


def _named(environment: str | Callable[..., Any], *, elsewhere: bool) -> str:
    """Return an environment's name, written out as module:name where a plug-in has a short one."""
    return plugin_registry.environment(environment_name(environment, elsewhere=elsewhere))


def _names(plugins: Sequence[str]) -> Sequence[str]:
    """Return names of plug-ins; raise ConfigError for a text, which would be taken letter by letter."""
    if isinstance(plugins, str):
        raise ConfigError(f"plugins is a list of names, [{plugins!r}] for one.")
    return plugins


def _load(plugins: Sequence[str]) -> None:
    for name in plugins:
        plugin_registry.load(name)
