"""EIA-SEC: distributed multi-agent reinforcement learning over Eclipse Zenoh.

    import eia_sec
    policy = eia_sec.train("quick", {"episodes": 200})
    print(eia_sec.evaluate(policy).total.reward)

These names are the public face of the package. The functions are loaded when they are first used, so `import eia_sec`
loads neither torch nor the simulator.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING

from eia_sec.common.errors import EnvironmentOutageError

if TYPE_CHECKING:
    from eia_sec.deploy.api import evaluate, load_policy, make_env, train

__all__ = ["EnvironmentOutageError", "__version__", "evaluate", "load_policy", "make_env", "train"]

__version__ = version("eia-sec")


def __getattr__(name: str) -> object:
    """Return one of the public functions."""
    if name not in __all__:
        raise AttributeError(f"module 'eia_sec' has no attribute {name!r}")
    return getattr(import_module("eia_sec.deploy.api"), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
