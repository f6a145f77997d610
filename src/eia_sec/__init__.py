"""EIA-SEC: distributed multi-agent reinforcement learning over Eclipse Zenoh.

    import eia_sec
    run = eia_sec.train("mytask.env:Cover", algorithm="ippo", workers=4, steps=150_000)
    print(run.evaluate(scenarios=50).interval)

These names are the public face of the package. They are loaded when they are first used, so `import eia_sec` loads
neither torch nor the simulator.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

from eia_sec.common.callbacks import Callback, TrainingProgress
from eia_sec.common.errors import EnvironmentOutageError

if TYPE_CHECKING:
    from eia_sec.common.plugins import Plugin, PluginAlgorithm, PluginNetwork
    from eia_sec.deploy.api import evaluate, load_policy, make_env, train
    from eia_sec.deploy.python.run import Run
    from eia_sec.rollout.agent_policy import Policy
    from eia_sec.rollout.envs.vectorised import Vectorised

__all__ = [
    "Callback",
    "EnvironmentOutageError",
    "Plugin",
    "PluginAlgorithm",
    "PluginNetwork",
    "Policy",
    "Run",
    "TrainingProgress",
    "Vectorised",
    "__version__",
    "evaluate",
    "load_policy",
    "make_env",
    "train",
]

_LAZY: Final = {
    **dict.fromkeys(("Plugin", "PluginAlgorithm", "PluginNetwork"), "eia_sec.common.plugins"),
    "Policy": "eia_sec.rollout.agent_policy",
    "Run": "eia_sec.deploy.python.run",
    "Vectorised": "eia_sec.rollout.envs.vectorised",
    **dict.fromkeys(("evaluate", "load_policy", "make_env", "train"), "eia_sec.deploy.api"),
}
"""Where the names are that are loaded when they are first used."""

__version__ = version("eia-sec")


def __getattr__(name: str) -> object:
    """Return one of the public names."""
    if name not in _LAZY:
        raise AttributeError(f"module 'eia_sec' has no attribute {name!r}")
    return getattr(import_module(_LAZY[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
