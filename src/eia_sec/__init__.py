"""EIA-SEC: distributed multi-agent reinforcement learning over Eclipse Zenoh."""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("eia-sec")
