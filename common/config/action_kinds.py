"""Which algorithms can train discrete actions."""

from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS


def discrete_algorithms() -> tuple[str, ...]:
    """Return the names of the algorithms that can train discrete actions; all can train continuous ones."""
    return tuple(name for name, kind in ALGORITHM_CONFIGS.items() if kind.discrete_actions)
