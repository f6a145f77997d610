"""Range checks that refuse an impossible value in one sentence.

Each check is one chain of comparisons: false for NaN, and right for integers of any size.
"""

import math

from eia_sec.common.errors import ConfigError


def positive(**values: float) -> None:
    """Raise ConfigError unless every value is finite and above zero."""
    for name, value in values.items():
        if not 0 < value < math.inf:
            raise ConfigError(f"{name} must be above 0, not {value}.")


def not_negative(**values: float) -> None:
    """Raise ConfigError unless every value is finite and at least zero."""
    for name, value in values.items():
        if not 0 <= value < math.inf:
            raise ConfigError(f"{name} must be 0 or more, not {value}.")


def within(low: float, high: float, **values: float) -> None:
    """Raise ConfigError unless every value lies in the closed interval from low to high."""
    for name, value in values.items():
        if not low <= value <= high:
            raise ConfigError(f"{name} must be between {low} and {high}, not {value}.")


def finite(**values: float) -> None:
    """Raise ConfigError unless every value is finite."""
    for name, value in values.items():
        if not -math.inf < value < math.inf:
            raise ConfigError(f"{name} must be a finite number, not {value}.")
