"""Options of the network; every process reads them, so this module loads no torch."""

from dataclasses import dataclass

from eia_sec.common.config import NetworkConfig


@dataclass(frozen=True)
class AttentionOptions(NetworkConfig):
    """Attention over the neighbours that an agent sees."""

    width: int = 32
    """Numbers that stand for an agent."""
