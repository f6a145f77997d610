"""Whether a run's networks can read what its environment shows, and work, before any process of it starts."""

from collections.abc import Sequence
from typing import Final

from eia_sec.common import plugins
from eia_sec.common.actors import actor_outputs
from eia_sec.common.config import ALGORITHM_CONFIGS, OnPolicyConfig, RunConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.team import GroupSpec, TeamSpec

EXAMPLE: Final = "the CNN of docs/examples is one: --plugin pictures --algorithm.network cnn"


def require_networks(config: RunConfig, team: TeamSpec) -> None:
    """Refuse networks that cannot read what agents observe.

    Raises:
        ConfigError: they read something else.
        PluginError: no loaded plug-in has the network.
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
    _require_joined_images(config, team)


def try_networks(config: RunConfig, team: TeamSpec) -> None:
    """Make and call the networks of a plug-in, whose sizes have been found to fit.

    Raises:
        PluginError: one cannot be made or used.
    """
    module = config.module
    if module is None:
        return
    from eia_sec.common.module_trials import try_network  # noqa: PLC0415  (loads torch; perceptrons do without here)

    for group in team.groups:
        try_network(module, group.seen, actor_outputs(group, "gaussian"))
        try_network(module, *((team.seen, group.count) if config.on_policy.sees_team else (group.seen, 1)))


def _require_vectors(config: RunConfig, groups: Sequence[GroupSpec]) -> None:
    """Raise ConfigError for images, which perceptrons do not read."""
    for group in groups:
        if group.image and config.learns_on_policy:
            raise ConfigError(
                f"the {group.name} agents of {config.env.name} see {_seen(group)}, which the perceptrons of "
                f"algorithm.network mlp do not read; choose a plug-in's network that reads images ({EXAMPLE})."
            )
        if group.image:
            learning = ", ".join(name for name, kind in ALGORITHM_CONFIGS.items() if issubclass(kind, OnPolicyConfig))
            raise ConfigError(
                f"the {group.name} agents of {config.env.name} see {_seen(group)}, from which {config.algorithm.name} "
                f"does not learn; {learning} do, with a plug-in's network that reads images ({EXAMPLE})."
            )


def _require_joined_images(config: RunConfig, team: TeamSpec) -> None:
    """Raise ConfigError where value functions see all agents' images and cannot join them."""
    if config.on_policy.sees_team and len({group.seen[1:] for group in team.groups}) > 1:
        raise ConfigError(
            f"the value functions of {config.algorithm.name} see all agents at once, and those of {config.env.name} "
            "see images of several sizes, or some see none; ippo's see one agent each."
        )


def _seen(group: GroupSpec) -> str:
    return f"images of {list(group.image)}" if group.image else f"vectors of {group.observation_size} numbers"
