"""Refuses options without effect under the chosen algorithm, in a sentence that names the algorithms that use them."""

from dataclasses import fields
from operator import attrgetter
from typing import Final

from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS, OPTIONAL_SECTIONS
from eia_sec.common.config.algorithms.network import MLP
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.run import RunConfig

SWITCHES: Final = (
    ("algorithm.ensemble_", "algorithm.ensemble", False),
    ("elite.", "elite.enabled", False),
    ("elite.", "algorithm.shared_until", 1.0),
    ("algorithm.sequence_", "algorithm.memory", "none"),
    ("env.", "env.name", FARM),
    ("population.", "population.members", 0),
    ("farm.dynamics.", "farm.dynamics.model", "instant"),
    ("farm.battery.", "farm.battery.capacity", 0.0),
    ("farm.relay.base", "farm.relay.require_link", False),
    ("farm.relay.hop_range", "farm.relay.base", ""),
)
"""The beginning of options' keys, the switch of their part of the configuration, and its value when the part is off."""

OF_MLP: Final = ("algorithm.hidden", "algorithm.memory", "algorithm.sequence_steps", "algorithm.suggestion_logits")
"""Options of the perceptrons of this package."""


def without_effect(config: RunConfig, key: str) -> str | None:
    """Return why an option has no effect in a configuration, or None when it has one or does not exist.

    Args:
        config: the configuration.
        key: the option with dots, algorithm.temperature for instance, or a whole section.
    """
    name, (section, _, field) = config.algorithm.name, key.partition(".")
    if section in OPTIONAL_SECTIONS and section not in config.algorithm.sections:
        return _sentence(key, name, [other for other, kind in ALGORITHM_CONFIGS.items() if section in kind.sections])
    field = field.partition(".")[0]
    if section == "algorithm" and (not hasattr(config.algorithm, field) or field in config.algorithm.unread):
        kinds = ALGORITHM_CONFIGS.items()
        owners = [other for other, kind in kinds if field in {f.name for f in fields(kind)} - {*kind.unread}]
        return _sentence(key, name, owners) if owners else None
    return None


def switched_off(config: RunConfig, key: str) -> str | None:
    """Return why an option has no effect because its part of the configuration is switched off, or None."""
    if key.startswith("farm.") and config.env.is_third_party:
        return f"{key} has no effect with {config.env.name}."
    if key in OF_MLP and config.module is not None:
        return f"{key} has no effect with the network {config.module.name}; it is an option of {MLP}."
    for part, switch, off in SWITCHES:
        section, _, field = switch.rpartition(".")
        if key.startswith(part) and key != switch and getattr(attrgetter(section)(config), field, None) == off:
            return f"{key} has no effect while {switch} is {str(off).lower() or 'empty'}."
    return None


def _sentence(key: str, name: str, owners: list[str]) -> str:
    return f"{key} has no effect with {name}; it is an option of {', '.join(owners)}."
