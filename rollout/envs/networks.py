"""Whether a run's networks can read what its environment shows, before any process of it starts."""

from collections.abc import Sequence
from typing import Final

from eia_sec.common import plugins
from eia_sec.common.actors import actor_parameters
from eia_sec.common.config import NetworkConfig, RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.team import GroupSpec, TeamSpec

EXAMPLE: Final = "the CNN of docs/examples is one: --plugin pictures --algorithm.network cnn"


def require_networks(config: RunConfig, team: TeamSpec) -> None:
    """Refuse networks that cannot read what agents observe.

    Raises:
        ConfigError: they read something else.
        PluginError: a plug-in's network cannot be made or used.
    """
    module = config.module
    if module is None:
        _require_vectors(config, team.groups)
        return
    plugin, network = plugins.network(module.name)
    reads = (network.reads,) if isinstance(network.reads, str) else network.reads
    for group in team.groups:
        seen = "image" if group.image else "vector"
        if seen not in reads:
            raise ConfigError(
                f"the {group.name} agents of {config.env.name} see {_seen(group)}, and the network {module.name} of "
                f"the plug-in {plugin} reads {' and '.join(f'{each}s' for each in reads)}; say with reads what it "
                "reads, or choose another one with --algorithm.network."
            )
        actor_parameters(group, config.algorithm.hidden, "gaussian", module=module)
    _require_values(config, module, team)


def _require_vectors(config: RunConfig, groups: Sequence[GroupSpec]) -> None:
    """Raise ConfigError for images, which perceptrons do not read."""
    for group in groups:
        if group.image and config.learns_on_policy:
            raise ConfigError(
                f"the {group.name} agents of {config.env.name} see {_seen(group)}, which the perceptrons of "
                f"algorithm.network mlp do not read; choose a plug-in's network that reads images ({EXAMPLE})."
            )
        if group.image:
            raise ConfigError(
                f"the {group.name} agents of {config.env.name} see {_seen(group)}, from which {config.algorithm.name} "
                f"does not learn; ippo, mappo and eia-ppo do, with a plug-in's network that reads images ({EXAMPLE})."
            )


def _require_values(config: RunConfig, module: NetworkConfig, team: TeamSpec) -> None:
    """Raise ConfigError where value functions see all agents' images and cannot join them, or PluginError."""
    sees_team = config.on_policy.sees_team
    if sees_team and len({group.seen[1:] for group in team.groups}) > 1:
        raise ConfigError(
            f"the value functions of {config.algorithm.name} see all agents at once, and those of {config.env.name} "
            "see images of several sizes, or some see none; ippo's see one agent each."
        )
    from eia_sec.common.modules import flat_size  # noqa: PLC0415  (loads torch, which perceptrons here do without)

    for group in team.groups:
        flat_size(module, *((team.seen, group.count) if sees_team else (group.seen, 1)))


def _seen(group: GroupSpec) -> str:
    return f"images of {list(group.image)}" if group.image else f"vectors of {group.observation_size} numbers"
