"""The environments that a run can use, by `env.name`.

To add one to this package, write a class that implements `eia_sec.rollout.envs.base.Environments` and add a line to
FACTORIES. Its key is the value of `env.name`, an identifier without a colon. An environment outside this package needs
no line: name any PettingZoo parallel environment as module:name.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext
from typing import Final

from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.config.action_kinds import continuous_algorithms, discrete_algorithms
from eia_sec.common.config.environment import FARM, MOST_EPISODE_STEPS, EnvConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_environment, farm_of
from eia_sec.common.protocol.message_sizes import require_frames
from eia_sec.common.team import TeamSpec
from eia_sec.rollout.envs.base import Environments, Patience, Reach
from eia_sec.rollout.envs.networks import require_networks, try_networks
from eia_sec.rollout.heuristics.random import RandomPolicy

TRIAL_STEPS: Final = 3
"""Steps of the trial of an environment from outside."""
Factory = Callable[[RunConfig, int, bool], Environments]
"""Makes the given number of environments for a run; True asks for `Environments.hindsight`, where there is any."""


def _farms(config: RunConfig, count: int, hindsight: bool) -> Environments:
    from eia_sec.rollout.heuristics.farms import make_farms  # noqa: PLC0415  (loads the simulator)

    return make_farms(config.farm, count, config.rollout.threads, hindsight)


def _pettingzoo(config: RunConfig, count: int, patience: Patience | None, reach: Reach | None) -> Environments:
    from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch  # noqa: PLC0415  # pettingzoo loads only for its users

    make = None
    if config.env.served:
        from eia_sec.rollout.remote.served import ServedEnvironments  # noqa: PLC0415  (likewise)

        if reach is None:
            raise ConfigError(f"{config.env.name} is reached from train, rollout and evaluate only.")
        make = ServedEnvironments(reach, config.env.served).make
    elif (vectorised := _vectorised(config, count)) is not None:
        return vectorised
    boxes = not config.algorithm.discrete_actions
    return PettingZooBatch(config.env, count, boxes=boxes, patience=patience, make=make)


def _vectorised(config: RunConfig, count: int) -> Environments | None:
    """Return environments that step as one batch, or None if the name stands for others."""
    from eia_sec.rollout.envs.vectorised import VectorisedBatch, vectorised_class  # noqa: PLC0415  (likewise)

    if vectorised_class(config.env.name) is None:
        return None
    return VectorisedBatch(config.env, count, config.rollout.threads)


FACTORIES: Final[dict[str, Factory]] = {
    FARM: _farms,
}
"""Environments of this package by name. A name with a colon is a PettingZoo environment's."""


def make_environments(
    config: RunConfig,
    count: int,
    hindsight: bool = False,
    patience: Patience | None = None,
    reach: Reach | None = None,
) -> Environments:
    """Return `count` environments of a run.

    Args:
        config: the run.
        count: how many.
        hindsight: whether to track `Environments.hindsight`; where there is none, it stays None.
        patience: what to do while a simulator or robot is away; without it, `EnvironmentOutageError` passes through.
        reach: how environments are reached that others serve.

    Raises:
        ConfigError: the environment that the configuration names does not exist or cannot be trained,
            or a farm cannot track hindsight.
    """
    if config.env.is_third_party:
        return _pettingzoo(config, count, patience, reach)
    require_known(config.env)
    return FACTORIES[config.env.name](config, count, hindsight)


def require_known(env: EnvConfig) -> None:
    """Raise ConfigError for a name that is neither module:name nor an environment of this package."""
    if not env.is_third_party and env.name not in FACTORIES:
        raise ConfigError(
            f"env.name must be module:name or an environment of this package ({', '.join(FACTORIES)}), "
            f"not {env.name!r}."
        )


def change_arguments(environments: Environments, arguments: str) -> None:
    """Make each environment with other arguments, a JSON object, when its next episode begins.

    Raises:
        ConfigError: the environments take no arguments, or they are no JSON object.
    """
    from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch  # noqa: PLC0415  # pettingzoo loads only for its users

    if not isinstance(environments, PettingZooBatch):
        raise ConfigError(
            "only environments named as module:name that do not step as one batch take arguments that change while a "
            "run trains."
        )
    environments.change_arguments(arguments)


def infos_alarm(environments: Environments) -> str:
    """Return a sentence about numbers in infos that cannot become metrics, or an empty string."""
    infos = getattr(environments, "infos", None)
    return "" if infos is None else str(infos.alarm)


def environment_spec(
    config: RunConfig, *, trial: bool = False, patience: Patience | None = None, reach: Reach | None = None
) -> EnvironmentSpec:
    """Return what generic code needs to know about a run's environment.

    Args:
        config: the run.
        patience: as for `make_environments`.
        trial: whether an environment from outside is also tried for TRIAL_STEPS steps with random actions, so that
            its mistakes show before any process of a run starts.
        reach: how environments are reached that others serve.

    Raises:
        ConfigError: as for `make_environments`; the algorithm cannot train these actions; or a chunk, the actors or an
            evaluation would not fit into a message.
        ContractError, EnvironmentFaultError: see `eia_sec.rollout.envs.guard`.
    """
    farm = farm_of(config)
    if farm is not None and not farm.battery.watched:
        # Without loading the simulator.
        return _trainable(config, _farm_spec(farm))
    with patient_with(config), closing(make_environments(config, 1, patience=patience, reach=reach)) as environments:
        spec = _trainable(config, environments.spec)
        if trial and config.env.is_third_party:
            _try(environments)
    return spec


def spec_of_team(config: RunConfig, team: TeamSpec) -> EnvironmentSpec:
    """Return the description of environments from outside whose team is known; raises as `environment_spec`."""
    return _trainable(config, EnvironmentSpec(team, (1, config.env.steps or MOST_EPISODE_STEPS)))


def patient_with(config: RunConfig) -> AbstractContextManager[None]:
    """Return a block in which calls of an environment from outside are watched, see `watchdog.watched`."""
    if not config.env.is_third_party:
        return nullcontext()
    from eia_sec.rollout.envs.watchdog import watched  # noqa: PLC0415  (pettingzoo loads only for its users)

    return watched(config.env.step_timeout)


def _farm_spec(farm: FarmConfig) -> EnvironmentSpec:
    from eia_sec.rollout.sim.core.constants import constants  # noqa: PLC0415  (loads the compiler)

    # Refuses farms that cannot be simulated.
    constants(farm)
    return farm_environment(farm)


def _try(environments: Environments) -> None:
    """Begin an episode and take some steps."""
    policy = RandomPolicy()
    environments.reset(0, 0, 0)
    policy.reset(environments, 0)
    for _ in range(TRIAL_STEPS):
        if not environments.ended.all():
            environments.step(policy.act(environments))


def _trainable(config: RunConfig, spec: EnvironmentSpec) -> EnvironmentSpec:
    """Return the description; raise ConfigError if it cannot be trained."""
    _require_actions(config, spec.team)
    require_networks(config, spec.team)
    if config.env.served and config.imitates and config.elite.farms:
        raise ConfigError(
            f"elite.farms {config.elite.farms} evaluates elites beside training, which environments that others serve "
            "do not allow: add --elite.farms 0, which scores agents by their rewards in training."
        )
    require_frames(config, spec)
    try_networks(config, spec.team)
    return spec


def _require_actions(config: RunConfig, team: TeamSpec) -> None:
    """Raise ConfigError for actions that the algorithm cannot train."""
    discrete = [group.name for group in team.groups if group.choices]
    continuous = [group.name for group in team.groups if not group.choices]
    for what, types, trained, able in (
        ("discrete", discrete, config.algorithm.discrete_actions, discrete_algorithms),
        ("continuous", continuous, config.algorithm.continuous_actions, continuous_algorithms),
    ):
        if types and not trained:
            raise ConfigError(
                f"{config.env.name} has {what} actions ({', '.join(types)}), which {config.algorithm.name} cannot "
                f"train; {', '.join(able())} can."
            )
