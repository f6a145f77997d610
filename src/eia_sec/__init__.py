"""EIA-SEC: distributed multi-agent reinforcement learning over Eclipse Zenoh."""

from importlib.metadata import version

from eia_sec.common.errors import EnvironmentOutageError

__all__ = ["EnvironmentOutageError", "__version__"]

__version__ = version("eia-sec")
