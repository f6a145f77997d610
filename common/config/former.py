"""Converts configurations of earlier versions to the present options.

Until version 0.1, one flat section `[algorithm]` held the options of all algorithms, and three ablations of EIA-SEC
were separate algorithms. Such files keep their meaning.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from eia_sec.common.config.ablations import ABLATIONS
from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS
from eia_sec.common.errors import ConfigError

_OF_ALL: Final = {"ensemble_members", "actor_delay", "temperature"}
"""Options of different algorithms; only a complete file of an earlier version has all of them."""
_RENAMED: Final = {"exploration": {"start": "noise_std_start", "end": "noise_std_end"}}
"""Former names of options, by section."""


def upgraded(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a TOML table with names of earlier versions replaced by present ones."""
    result = {key: dict(value) if isinstance(value, dict) else value for key, value in table.items()}
    for section, names in _RENAMED.items():
        if isinstance(values := result.get(section), dict):
            result[section] = {names.get(key, key): value for key, value in values.items()}
    algorithm = result.get("algorithm")
    if isinstance(algorithm, dict):
        _split_algorithm(result, algorithm)
    return result


def refuse_ablation(name: str) -> None:
    """Raise ConfigError when a command line names an ablation by its former name."""
    if name in ABLATIONS:
        wanted = " and ".join(f"{key}=false" for key in ABLATIONS[name])
        raise ConfigError(f"{name} is an ablation of eia-sec: choose the preset {name}, or eia-sec and set {wanted}.")


def _split_algorithm(table: dict[str, Any], algorithm: dict[str, Any]) -> None:
    """Keep only the chosen algorithm's options in `[algorithm]`, and replace an ablation's name by its switches."""
    whole = algorithm.keys() >= _OF_ALL
    if algorithm.get("critic_scope") == "algorithm":
        del algorithm["critic_scope"]  # each class defaults to the scope that its algorithm prefers
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
