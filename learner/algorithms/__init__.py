"""Every algorithm by its name: what the files of this package define, each class with the names it answers to."""

from importlib import import_module
from pkgutil import iter_modules
from typing import Final

from common.config.learning import AlgorithmName
from learner.algorithms.base import Algorithm

for _file in iter_modules(__path__):
    import_module(f"{__name__}.{_file.name}")

ALGORITHMS: Final[dict[AlgorithmName, type[Algorithm]]] = {
    name: method
    for method in Algorithm.__subclasses__()
    if method.__module__.startswith(f"{__name__}.")
    for name in method.names
}
"""The classes by `algorithm.name`; the ablations of EIA-SEC are its own class with parts left out."""
