"""Configurations of earlier versions in today's terms.

Until version 0.1 one flat section `[algorithm]` had the options of all algorithms, whichever was chosen, and three
ablations of EIA-SEC were algorithms of their own. Files from then mean what they meant.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from common.config.ablations import ABLATIONS
from common.config.algorithms import ALGORITHM_CONFIGS
from common.errors import ConfigError

_OF_ALL: Final = {"ensemble_members", "actor_delay", "temperature"}
"""Options of different algorithms; only a file of an earlier version, written whole, has them all."""
_RENAMED: Final = {"exploration": {"start": "noise_std_start", "end": "noise_std_end"}}
"""Former names of options, by section."""


def upgraded(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a TOML table with today's names where it has names of earlier versions; the rest is as it was."""
    result = {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
    for section, names in _RENAMED.items():
        if isinstance(values := result.get(section), dict):
            result[section] = {names.get(key, key): value for key, value in values.items()}
    algorithm = result.get("algorithm")
    if isinstance(algorithm, dict):
        _split_algorithm(result, algorithm)
    return result


def refuse_ablation(name: str) -> None:
    """Raise ConfigError where a command line asks for an ablation by its former name."""
    if name in ABLATIONS:
        wanted = " and ".join(f"{key}=false" for key in ABLATIONS[name])
        raise ConfigError(f"{name} is an ablation of eia-sec: choose the preset {name}, or eia-sec and set {wanted}.")


def _split_algorithm(table: dict[str, Any], algorithm: dict[str, Any]) -> None:
    """Leave the chosen algorithm's own options in `[algorithm]`, and turn an ablation's name into its switches."""
    whole = algorithm.keys() >= _OF_ALL
    if algorithm.get("critic_scope") == "algorithm":
        del algorithm["critic_scope"]  # each class has the scope that its algorithm prefers as its default
    name = algorithm.get("name")
    if isinstance(name, str) and name in ABLATIONS:
        algorithm["name"] = "eia-sec"
        for key, value in ABLATIONS[name].items():
            section, _, field = key.partition(".")
            if isinstance(table.setdefault(section, {}), dict):
                table[section][field] = value
    chosen = ALGORITHM_CONFIGS.get(str(algorithm.get("name")))
    if whole and chosen is not None:
        known = {field.name for field in fields(chosen)}
        table["algorithm"] = {key: value for key, value in algorithm.items() if key in known}
        if "elite" not in chosen.sections:
            table.pop("elite", None)
