"""Plug-ins: algorithms, networks, heuristics, environments and callbacks from a user's own package.

    # mytask/__init__.py
    from eia_sec import Plugin, PluginAlgorithm
    plugin = Plugin(algorithms={"cautious": PluginAlgorithm("mytask.loss:Cautious", CautiousOptions)})

A plug-in is a module with a `Plugin` named `plugin`, or an entry point of the group `eia_sec.plugins`. `--plugin NAME`
loads it, and nothing loads that was not named. A run's configuration keeps the names, and every process of the run is
told them.

What a plug-in offers is named as module:name and imported where it is used, so that a worker or a coordinator does not
load torch for it.
"""

import functools
import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from importlib.metadata import entry_points
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

import numpy as np

from eia_sec.common.callbacks import Callback
from eia_sec.common.config.algorithms import ALGORITHM_CONFIGS, AlgorithmConfig, IppoConfig
from eia_sec.common.config.algorithms.base import Options, named
from eia_sec.common.config.algorithms.network import NETWORK_CONFIGS, NetworkConfig
from eia_sec.common.config.environment import FARM
from eia_sec.common.config.plugin_names import LOADED, PluginNames
from eia_sec.common.errors import PluginError
from eia_sec.common.names import is_name

GROUP: Final = "eia_sec.plugins"
"""Group of entry points that name plug-ins."""
MEMBER: Final = "plugin"
"""Name of the `Plugin` in a plug-in's module."""


@dataclass(frozen=True)
class PluginAlgorithm:
    """An algorithm of a plug-in.

    Attributes:
        learner: module:name of its class: derived from `Ippo`, `Mappo` or another `Ppo`, or off policy from `Maddpg` or
            another `Algorithm`.
        options: dataclass of its options, derived from those of the algorithm that the class derives from.
    """

    learner: str
    options: type[AlgorithmConfig] = IppoConfig


Reads = Literal["vector", "image"]
"""What a network reads: vectors of numbers, or images of bytes."""


@dataclass(frozen=True)
class PluginNetwork:
    """A network of a plug-in, for actors and value functions that learn on policy.

    Attributes:
        module: module:name of a class derived from `torch.nn.Module`, or of a function that makes such a module.
            `eia_sec.common.modules` says how it is made and called.
        options: dataclass of its options, derived from `NetworkConfig`.
        reads: what it reads: "vector", "image", or both.
    """

    module: str
    options: type[NetworkConfig] = NetworkConfig
    reads: Reads | Sequence[Reads] = "vector"


@dataclass(frozen=True)
class Plugin:
    """What a user's package adds.

    Attributes:
        algorithms: by `algorithm.name`.
        networks: by `algorithm.network.name`.
        heuristics: module:name of a policy's class by the name that `--policy` takes, see docs/how-to/plugins.md.
        environments: module:name of a PettingZoo parallel environment by the name that `--env` takes.
        callbacks: module:name of classes derived from `Callback`; the learner makes and calls one of each.
    """

    algorithms: Mapping[str, PluginAlgorithm] = field(default_factory=dict)
    networks: Mapping[str, PluginNetwork] = field(default_factory=dict)
    heuristics: Mapping[str, str] = field(default_factory=dict)
    environments: Mapping[str, str] = field(default_factory=dict)
    callbacks: Sequence[str] = ()


_PLUGINS: Final[dict[str, Plugin]] = {}


def load(name: str) -> None:
    """Load a plug-in, once.

    Args:
        name: of an entry point of GROUP, or of a module.

    Raises:
        PluginError: there is none, it cannot be imported, or it offers something that cannot be used.
    """
    if name in _PLUGINS:
        return
    found = _imported(name)
    if not isinstance(found, Plugin):
        raise PluginError(
            f"plug-in {name}: {MEMBER} is {_type(found)}, and must be an eia_sec.Plugin; set {MEMBER} = Plugin(...) in "
            "its module."
        )
    _check_names(name, found)
    algorithms = {own: _algorithm_options(name, own, each) for own, each in found.algorithms.items()}
    networks = {own: _network_options(name, own, each) for own, each in found.networks.items()}
    ALGORITHM_CONFIGS.update(algorithms)
    NETWORK_CONFIGS.update(networks)
    _PLUGINS[name] = found
    LOADED.append(name)


def loaded() -> PluginNames:
    """Return the names of all loaded plug-ins."""
    return PluginNames(LOADED)


def environment(name: str) -> str:
    """Return module:name of an environment that a plug-in has named, or the name itself."""
    return next((own.environments[name] for own in _PLUGINS.values() if name in own.environments), name)


def require_heuristics_beside(names: Sequence[str]) -> None:
    """Raise PluginError for a heuristic of a plug-in that has one of these names."""
    for plugin, own in _PLUGINS.items():
        if taken := sorted({*names} & {*own.heuristics}):
            raise PluginError(f"plug-in {plugin}: the name {taken[0]} is taken.")


def heuristic(name: str) -> Any:
    """Return a new heuristic of a plug-in, or None where none has this name.

    Its methods raise PluginError for an exception of theirs.

    Raises:
        PluginError: it cannot be made, or it lacks a method.
    """
    for plugin, own in _PLUGINS.items():
        if name in own.heuristics:
            return _Heuristic(own.heuristics[name], f"plug-in {plugin}: heuristic {name}")
    return None


def heuristics() -> list[str]:
    """Return the names of all heuristics of loaded plug-ins."""
    return [name for own in _PLUGINS.values() for name in own.heuristics]


def heuristic_at(where: str) -> Any:
    """Return a new heuristic of the class that module:name names, as `heuristic` does."""
    return _Heuristic(where, f"heuristic {where}")


class _Heuristic:
    """A plug-in's heuristic.

    Args:
        where: module:name.
        what: what it is, for errors.

    Raises:
        PluginError: it cannot be made, or it lacks a method.
    """

    def __init__(self, where: str, what: str) -> None:
        found = _made(resolve(where, what), what)
        for method in ("reset", "act"):
            if not callable(getattr(found, method, None)):
                raise PluginError(f"{what}: {where} has no method {method}; policies have reset and act.")
        self.reset = guarded(found.reset, f"{what}: reset", (object,))
        self._act = guarded(found.act, f"{what}: act", (np.ndarray,))
        self._what = what

    def act(self, environments: Any) -> Any:
        """Return the heuristic's actions [E, A]; raise PluginError where they are none that environments take."""
        actions = self._act(environments)
        wanted = (len(environments.time), environments.team.environment_action_size)
        if actions.shape != wanted:
            raise PluginError(
                f"{self._what}: act returned {list(actions.shape)} numbers, and must return {list(wanted)}."
            )
        if actions.dtype.kind not in "iuf" or not np.isfinite(actions).all():
            raise PluginError(f"{self._what}: act returned something that is no finite number.")
        return actions


def callbacks(named: Sequence[str]) -> list[Callback]:
    """Return a new callback of each class that some loaded plug-ins name.

    Args:
        named: names of the plug-ins, as a run's configuration has them.

    Raises:
        PluginError: one cannot be made, or is no callback.
    """
    made = []
    for what, found in _callback_classes(named):
        each = _made(found, what)
        if not isinstance(each, Callback):
            raise PluginError(f"{what} is {_type(each)}; it must derive from eia_sec.Callback.")
        made.append(each)
    return made


def check_callbacks(named: Sequence[str]) -> None:
    """Raise PluginError where `callbacks` would, as far as can be told without making one."""
    for what, found in _callback_classes(named):
        if not callable(found):
            raise PluginError(f"{what} is {_type(found)}, and must be a class or a function.")
        if isinstance(found, type) and not issubclass(found, Callback):
            raise PluginError(f"{what} is a {found.__name__}; it must derive from eia_sec.Callback.")


def _callback_classes(named: Sequence[str]) -> Iterator[tuple[str, Any]]:
    for plugin in named:
        for where in _PLUGINS[plugin].callbacks:
            what = f"plug-in {plugin}: callback {where}"
            yield what, resolve(where, what)


def guarded(method: Callable[..., Any], where: str, wanted: tuple[type, ...]) -> Callable[..., Any]:
    """Return a user's method that raises PluginError, which names it, for an exception or another result.

    Args:
        method: the method.
        where: what it is, for errors.
        wanted: types that it may return.
    """

    @functools.wraps(method)
    def call(*given: Any, **named: Any) -> Any:
        try:
            found = method(*given, **named)
        except PluginError:
            raise  # of a method that this one has called
        except Exception as error:  # a user's method may raise anything
            raise PluginError(f"{where} raised {type(error).__name__}: {error}") from error
        if not isinstance(found, wanted):
            names = " or ".join(each.__name__ for each in wanted)
            raise PluginError(f"{where} returned {_type(found)}, and must return a {names}.")
        return found

    return call


def algorithm(name: str) -> tuple[str, type[Any]] | None:
    """Return the plug-in and the learner's class of an algorithm, or None where no plug-in has it.

    Raises:
        PluginError: the class cannot be imported.
    """
    for plugin, own in _PLUGINS.items():
        if name in own.algorithms:
            what = f"plug-in {plugin}: algorithm {name}"
            found = resolve(own.algorithms[name].learner, what)
            if not isinstance(found, type):
                raise PluginError(f"{what}: {own.algorithms[name].learner} is {_type(found)}, and must be a class.")
            return plugin, found
    return None


def network(name: str) -> tuple[str, PluginNetwork]:
    """Return the plug-in of a network, and the network.

    Raises:
        PluginError: no loaded plug-in has it.
    """
    for plugin, own in _PLUGINS.items():
        if name in own.networks:
            return plugin, own.networks[name]
    raise PluginError(f"no loaded plug-in has a network {name}.")


def owners(algorithm: str, network: str | None) -> tuple[str, ...]:
    """Return the loaded plug-ins that an algorithm and a network are of; nothing for those of this package."""
    return tuple(plugin for plugin, own in _PLUGINS.items() if algorithm in own.algorithms or network in own.networks)


def resolve(where: str, what: str) -> Any:
    """Return what module:name names.

    Args:
        where: module:name.
        what: what it is, for errors.

    Raises:
        PluginError: it cannot be imported.
    """
    module, _, member = where.partition(":")
    try:
        found = importlib.import_module(module)
        for part in member.split("."):
            found = getattr(found, part)
    except Exception as error:  # a user's module may raise anything
        raise PluginError(f"{what}: {where} cannot be imported: {type(error).__name__}: {error}") from error
    return found


def _imported(name: str) -> Any:
    known = [point for point in entry_points(group=GROUP) if point.name == name]
    module = known[0].module if known else name
    try:
        if known:
            return known[0].load()
        return getattr(importlib.import_module(name), MEMBER, None)
    except Exception as error:  # a user's module may raise anything
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            hint = "install its package, or name its folder in PYTHONPATH"
            raise PluginError(f"there is no plug-in {name}: {error} ({hint}).") from error
        raise PluginError(f"plug-in {name} cannot be imported: {type(error).__name__}: {error}") from error


def _check_names(name: str, found: Plugin) -> None:
    others = {own for each in _PLUGINS.values() for own in (*each.heuristics, *each.environments)}
    taken = others | {*ALGORITHM_CONFIGS, *NETWORK_CONFIGS, FARM}
    for own in (*found.algorithms, *found.networks, *found.heuristics, *found.environments):
        if not isinstance(own, str) or not is_name(own):
            raise PluginError(f"plug-in {name}: {own!r} is no name of 1 to 63 letters, digits, '.', '_' or '-'.")
        if own in taken:
            raise PluginError(f"plug-in {name}: the name {own} is taken.")
    for what, places in (
        ("heuristic", found.heuristics.values()),
        ("environment", found.environments.values()),
        ("callback", found.callbacks),
    ):
        for where in places:
            if not isinstance(where, str) or not where.partition(":")[2]:
                raise PluginError(f"plug-in {name}: a {what} is named as module:name, not {where!r}.")


def _algorithm_options(plugin: str, name: str, each: PluginAlgorithm) -> type[AlgorithmConfig]:
    what = f"plug-in {plugin}: algorithm {name}"
    if not isinstance(each, PluginAlgorithm):
        raise PluginError(f"{what} is {_type(each)}, and must be an eia_sec.PluginAlgorithm.")
    return _options(what, name, each.options, AlgorithmConfig, "IppoConfig or another one")


def _network_options(plugin: str, name: str, each: PluginNetwork) -> type[NetworkConfig]:
    what = f"plug-in {plugin}: network {name}"
    if not isinstance(each, PluginNetwork):
        raise PluginError(f"{what} is {_type(each)}, and must be an eia_sec.PluginNetwork.")
    if not isinstance(each.module, str) or not each.module.partition(":")[2]:
        raise PluginError(f"{what}: its module is named as module:name, not {each.module!r}.")
    if not (each.reads in get_args(Reads) or (each.reads and {*each.reads} <= {*get_args(Reads)})):
        raise PluginError(f"{what} reads {each.reads!r}, and must read {' or '.join(get_args(Reads))}, or both.")
    found = _options(what, name, each.options, NetworkConfig, "NetworkConfig")
    _require_plain(what, each.options, found)
    return found


def _options(what: str, name: str, options: Any, base: type[Options], wanted: str) -> type[Options]:
    """Return the class of a plug-in's options, whose `name` is the one that they have in the plug-in."""
    if not (isinstance(options, type) and issubclass(options, base) and is_dataclass(options)):
        raise PluginError(f"{what}: its options are {_type(options)}, and must be a dataclass derived from {wanted}.")
    if not options.__dataclass_params__.frozen:  # type: ignore[attr-defined]  # every dataclass has it
        raise PluginError(
            f"{what}: its options {options.__qualname__} must be a frozen dataclass, as those it derives from."
        )
    if missing := [each.name for each in fields(options) if each.name != "name" and not _has_default(each)]:
        raise PluginError(f"{what}: the option {missing[0]} of {options.__qualname__} has no default.")
    return named(options, name)


def _require_plain(what: str, options: type[NetworkConfig], found: type[NetworkConfig]) -> None:
    """Raise PluginError unless options are values of a configuration, which have a hash: networks are kept by them.

    Args:
        what: what they are of, for errors.
        options: their class in the plug-in.
        found: the class with the network's name.
    """
    try:
        hints = get_type_hints(options)
        hash(found())
    except Exception as error:  # a user's class may raise anything
        raise PluginError(f"{what}: its options {options.__qualname__} cannot be used: {error}.") from error
    for each in fields(options):
        items = get_args(hints[each.name])
        lists = get_origin(hints[each.name]) is tuple and {*items} <= {int, float, ...}
        if not (lists or get_origin(hints[each.name]) is Literal or hints[each.name] in (bool, int, float, str)):
            raise PluginError(
                f"{what}: the option {each.name} of {options.__qualname__} is a {each.type}, and must be a bool, int, "
                "float, str, Literal, or a tuple of ints or floats."
            )


def _has_default(option: Any) -> bool:
    return option.default is not option.default_factory  # both are MISSING where it has none


def _made(found: Any, what: str) -> Any:
    if not callable(found):
        raise PluginError(f"{what} is {_type(found)}, and must be a class or a function.")
    try:
        return found()
    except Exception as error:  # a user's constructor may raise anything
        raise PluginError(f"{what}: making it raised {type(error).__name__}: {error}") from error


def _type(found: Any) -> str:
    return "nothing" if found is None else f"a {type(found).__name__}"
