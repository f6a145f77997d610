"""Which algorithms can train discrete actions, and which continuous ones."""

from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS


def discrete_algorithms() -> tuple[str, ...]:
    """Return the names of the algorithms that can train discrete actions."""
    return tuple(name for name, kind in ALGORITHM_CONFIGS.items() if kind.discrete_actions)


def continuous_algorithms() -> tuple[str, ...]:
    """Return the names of the algorithms that can train continuous actions."""
    return tuple(name for name, kind in ALGORITHM_CONFIGS.items() if kind.continuous_actions)
