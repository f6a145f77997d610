"""Which algorithms can train discrete actions."""

from common.config.algorithms import ALGORITHM_CONFIGS, AlgorithmConfig


def trains_discrete(algorithm: AlgorithmConfig | type[AlgorithmConfig]) -> bool:
    """Return whether an algorithm can train discrete actions; all can train continuous ones."""
    return bool(getattr(algorithm, "discrete_actions", False))


def discrete_algorithms() -> tuple[str, ...]:
    """Return the names of the algorithms that can train discrete actions."""
    return tuple(name for name, kind in ALGORITHM_CONFIGS.items() if trains_discrete(kind))
