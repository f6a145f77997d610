"""Configurations of several algorithms from one, for tests that treat them alike."""

from dataclasses import fields, replace

from eia_sec.common.config import AlgorithmConfig
from eia_sec.common.config.algorithms import switched


def variant(base: AlgorithmConfig, name: str, **options) -> AlgorithmConfig:
    """Return an algorithm's configuration with the shared values of another's and those options that it has."""
    config = switched(base, name)
    known = {field.name for field in fields(config)}
    return replace(config, **{key: value for key, value in options.items() if key in known})
