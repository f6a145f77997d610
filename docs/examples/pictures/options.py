"""Options of the network; every process reads them, so this module loads no torch."""

from dataclasses import dataclass

from eia_sec.common.config import NetworkConfig


@dataclass(frozen=True)
class CnnOptions(NetworkConfig):
    """A convolutional network for pictures."""

    channels: int = 8
    """Channels of both convolutions."""
    width: int = 64
    """Units of the layer behind them."""
