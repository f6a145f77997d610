"""The one place where code of a user's environment is called.

Whatever that code does, the process around it goes on as before:

- What it returns is checked. A violation of PettingZoo's contract is one sentence (`ContractError`).
- What it raises becomes an `EnvironmentFaultError` with the traceback of the user's own code; so does an attempt to end
  the program. An `EnvironmentOutageError` passes through, and so does what ends this process.
- Numpy's error state, torch's default type, warning filters, the working directory and the command line are the user's
  own inside a call and this process's own outside. Signal handlers are put back after each call.
- `os._exit`, which would end the process without a word, is an attempt to end the program like any other.
"""

import importlib
import math
import os
import signal
import sys
import threading
import time
import traceback
import warnings

# signal's own looks for a name of each handler, which takes longer than all else here.
from _signal import getsignal  # type: ignore[import-not-found]  # typeshed has no stub of it
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from types import ModuleType
from typing import Any, Final, NamedTuple, NoReturn, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from eia_sec.common.errors import (
    ConfigError,
    ContractError,
    EnvironmentFaultError,
    EnvironmentOutageError,
    TerminatedError,
)
from eia_sec.common.log import log
from eia_sec.common.transitions import LARGEST

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD, signal.SIGPIPE)
"""Signals that this process's own handlers get, whatever an environment installs."""
SHOWN: Final = 100
"""Most characters of a user's value in a sentence."""

PLAIN: Final = {float, int, np.float32, np.float64}
"""Types of which a reward is a number without further checks."""
LONGEST: Final = 4000
"""Most characters of a user's exception."""
RENDER_SECONDS: Final = 5.0
"""Time that a picture may take before it is given up."""
MOST_PIXELS: Final = 2**24
"""Most pixels of a picture."""

By: TypeAlias = Mapping[Any, Any]
"""Values by the name of an agent."""


class Step(NamedTuple):
    """What a step returned, checked.

    Attributes:
        observations: what the agents see, by name; every living agent has one.
        rewards: of the agents that acted, by name.
        terminations, truncations: by name.
        infos: by name.
    """

    observations: By
    rewards: Mapping[Any, float]
    terminations: By
    truncations: By
    infos: By


class Running(NamedTuple):
    """A call of a user's code that has not returned.

    Attributes:
        environment: module:name.
        method: what was called, step() for instance.
        since: when, by the monotonic clock.
        for_watchers: whether it only serves people who watch, see `for_watchers`.
    """

    environment: str
    method: str
    since: float
    for_watchers: bool = False

    @property
    def seconds(self) -> float:
        """Seconds since the call."""
        return time.monotonic() - self.since


class Ahead(ABC):
    """An environment that takes a step's actions before the step, so that several move at the same time."""

    @abstractmethod
    def ahead(self, actions: By) -> None:
        """Note the actions of the step that follows."""


class Guard:
    """A user's PettingZoo parallel environment, whose code is only called here.

    Args:
        name: module:name.
        factory: makes the environment; see `factory`.
        keywords: its arguments.

    Attributes:
        name: module:name.
        wrapped: the user's environment itself.
        possible_agents: names of all agents that may take part.
        agents: names of the living agents, as of the last call.

    Raises:
        ContractError: what was made is not a parallel environment, or does not name its agents, each once.
        EnvironmentFaultError: it cannot be made.
    """

    running: Running | None = None
    """The call that this process is in; one at a time."""

    def __init__(self, name: str, factory: Callable[..., Any], keywords: Mapping[str, Any]) -> None:
        self.name = name
        self.agents: list[Any] = []
        given = ", ".join(f"{key}={value!r}" for key, value in keywords.items())
        with calling(name, f"{name.partition(':')[2]}({given})") as method:
            self.wrapped = factory(**keywords)
            self._require(method, isinstance(self.wrapped, ParallelEnv), self.wrapped, "a pettingzoo.ParallelEnv")
            agents = getattr(self.wrapped, "possible_agents", None)
            named = isinstance(agents, Sequence) and not isinstance(agents, str) and len(agents) > 0
            self._require("possible_agents", named, agents, "a list of all agents' names")
            self.possible_agents = list(agents or ())
            for agent in self.possible_agents:
                str(agent)  # sentences and pages call it outside of this module
            self._require("possible_agents", _are_unique(self.possible_agents), agents, "each agent's name once")

    def observation_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's observation space."""
        return self._space("observation_space", agent)

    def action_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's action space."""
        return self._space("action_space", agent)

    def reset(self, seed: int) -> tuple[By, By]:
        """Begin an episode; return observations and infos by agent."""
        with calling(self.name, "reset()") as method:
            found = self.wrapped.reset(seed=seed)
            wanted = "a pair of dictionaries, observations and infos"
            self._require(method, _are_mappings(found, 2), found, wanted)
            observations, infos = found
            self._follow(method, observations, infos)
            self._require("agents", bool(self.agents), self.agents, "at least one living agent after reset()")
        return observations, infos

    def ahead(self, actions: By) -> None:
        """Note the actions of the step that follows, if that is of use to the environment."""
        if isinstance(self.wrapped, Ahead):
            self.wrapped.ahead(actions)

    def step(self, actions: By) -> Step:
        """Let the living agents act.

        Args:
            actions: their actions by name.
        """
        with calling(self.name, "step()") as method:
            found = self.wrapped.step(actions)
            wanted = "five dictionaries: observations, rewards, terminations, truncations and infos"
            self._require(method, _are_mappings(found, 5), found, wanted)
            observations, rewards, terminations, truncations, infos = found
            same = rewards.keys() == actions.keys()
            numbers = self._rewards(rewards if same else {name: rewards[name] for name in actions if name in rewards})
            self._follow(method, observations, infos)
            acted = actions.keys() & self.agents
            for what, given in (("reward", rewards), ("termination", terminations), ("truncation", truncations)):
                if missing := acted - given.keys():
                    self._require(method, False, given, f"a {what} of agent {min(missing, key=str)}")
            terminated, truncated = self._flags("termination", terminations), self._flags("truncation", truncations)
        return Step(observations, numbers, terminated, truncated, infos)

    def render(self) -> NDArray[np.uint8]:
        """Return a picture [height, width, 3] of the present state.

        Raises:
            ContractError: it is no such picture.
            EnvironmentFaultError: the environment raised something, or took longer than RENDER_SECONDS.
        """
        with for_watchers(RENDER_SECONDS), calling(self.name, "render()") as method:
            found = self.wrapped.render()
            fits = isinstance(found, np.ndarray) and found.dtype == np.uint8 and found.shape[2:] == (3,)
            fits = fits and 0 < found.size <= 3 * MOST_PIXELS
            self._require(method, fits, found, "a picture [height, width, 3] of bytes")
        picture: NDArray[np.uint8] = found
        return picture

    def _flags(self, what: str, given: By) -> Mapping[Any, bool]:
        """Return what terminations or truncations say; raise ContractError unless each is a truth value."""
        kinds = {*map(type, given.values())}
        if kinds <= {bool}:
            return given
        if kinds <= {bool, np.bool_}:
            return {name: bool(value) for name, value in given.items()}
        found = {}
        for name, value in given.items():
            if not isinstance(value, bool | np.bool_):
                truth = np.ndim(value) == 0 and not isinstance(value, str | bytes) and value is not None
                fits = truth and value in (0, 1)
                self._require("step()", fits, value, f"True or False as the {what} of agent {name}")
            found[name] = bool(value)
        return found

    def close(self) -> None:
        """Release what the environment holds; what it raises meanwhile is logged, because nothing depends on it."""
        try:
            with calling(self.name, "close()"):
                self.wrapped.close()
        except (EnvironmentFaultError, EnvironmentOutageError) as error:
            log(str(error))

    def _space(self, method: str, agent: Any) -> spaces.Space[Any]:
        with calling(self.name, f"{method}({agent!r})") as called:
            found = getattr(self.wrapped, method)(agent)
            self._require(called, isinstance(found, spaces.Space), found, "a gymnasium.spaces.Space")
        space: spaces.Space[Any] = found
        return space

    def _follow(self, method: str, observations: By, infos: By) -> None:
        """Take over the living agents, of which each must be seen."""
        self._require(method, _are_mappings([*infos.values()]), infos, "a dictionary as each agent's info")
        agents = getattr(self.wrapped, "agents", None)
        known = type(agents) is list and agents == self.agents  # they are those that were known before
        known = known or (
            isinstance(agents, Sequence) and _are_unique(agents) and set(agents) <= set(self.possible_agents)
        )
        self._require("agents", known, agents, f"a list of the living ones among possible_agents after {method}")
        self.agents = list(agents or ())
        for name in self.agents:
            if name not in observations:
                raise ContractError(
                    f"{self.name}: {method} returned no observation of agent {name}, which lives; PettingZoo asks for "
                    "one of each agent in agents."
                )

    def _rewards(self, given: By) -> Mapping[Any, float]:
        """Return the agents' rewards, checked at once where all are plain numbers; see `_reward`."""
        kinds, values = {*map(type, given.values())}, given.values()
        bounded = values and kinds <= PLAIN and min(values) >= -LARGEST and max(values) <= LARGEST
        # Comparisons with what is not a number are always false, so that it shows in the sum alone.
        if bounded and not math.isnan(sum(values)):
            return given if kinds == {float} else {name: float(value) for name, value in given.items()}
        return {name: self._reward(name, value) for name, value in given.items()}

    def _reward(self, name: Any, value: Any) -> float:
        """Return an agent's reward; raise ContractError unless it is a number that the learner takes."""
        if type(value) is not float:
            plain = not isinstance(value, str | bytes) and np.ndim(value) == 0
            try:
                number = float(value) if plain else None
            except (TypeError, ValueError, OverflowError):
                number = None
            self._require("step()", number is not None, value, f"one number as the reward of agent {name}")
            value = number
        if not -LARGEST <= value <= LARGEST:
            remedy = "scale the environment's rewards down" if math.isfinite(value) else "return a finite number"
            raise ContractError(
                f"{self.name}: step() returned a reward of {value:g} for agent {name}; the largest is {LARGEST:g}: "
                f"{remedy}."
            )
        reward: float = value
        return reward

    def _require(self, method: str, fits: bool, came: Any, wanted: str) -> None:
        if not fits:
            raise ContractError(f"{self.name}: {method} gave {shown(came)}; PettingZoo asks for {wanted}.")


def factory(name: str) -> Callable[..., Any]:
    """Return what makes the environment module:name.

    Raises:
        ConfigError: there is no such module or member, or it makes nothing.
        EnvironmentFaultError: the module cannot be imported.
    """
    module, _, member = name.partition(":")
    hint = "install its package, or name its folder in PYTHONPATH"
    found: Any = None
    with calling(name, f"import {module}"):
        try:
            found = importlib.import_module(module)
            for part in member.split("."):
                found = getattr(found, part, None) or importlib.import_module(f"{module}.{part}")
        except ImportError as error:
            raise ConfigError(f"there is no environment {name}: {error} ({hint}).") from None
        if isinstance(found, ModuleType):
            found = getattr(found, "parallel_env", None)
    if not callable(found):
        raise ConfigError(f"{name} is neither a callable nor a module with a parallel_env.")
    made: Callable[..., Any] = found
    return made


def shown(value: Any) -> str:
    """Return a user's value for a sentence, cut to SHOWN characters."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a user's __repr__ may raise anything
        text = f"a {type(value).__name__}"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


@contextmanager
def calling(name: str, method: str) -> Iterator[str]:
    """Call a user's code in this block, as this module says.

    Args:
        name: module:name of the environment.
        method: what is called, for sentences and alarms.

    Yields:
        The method.
    """
    ours, handlers = _Settings.now(), _handlers()
    _Exits.watch(name)
    (_theirs.pop() if _theirs else ours._replace(argv=[name])).apply(ours)
    limit = _for_watchers[-1] if _for_watchers else math.inf
    Guard.running = Running(name, method, time.monotonic(), bool(_for_watchers))
    try:
        with _limited(limit) if limit < math.inf else nullcontext():
            yield method
    except (ConfigError, ContractError, EnvironmentOutageError, TerminatedError):
        raise
    except SystemExit as error:
        raise EnvironmentFaultError(
            f"{_own_traceback(error)}{name}: {method} ended the program with exit code {error.code}; code that is "
            'imported must neither exit nor parse arguments outside of `if __name__ == "__main__"`.'
        ) from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise EnvironmentFaultError(
            f"{_own_traceback(error)}{name}: {method} raised {type(error).__name__}: {_said(error)}"
        ) from error
    finally:
        Guard.running = None
        _theirs.append(_Settings.now())
        ours.apply(_theirs[0])
        _restore(handlers)


_for_watchers: Final[list[float]] = []
"""Limits, in seconds, of the blocks of `for_watchers` that this process is in."""


@contextmanager
def for_watchers(seconds: float) -> Iterator[None]:
    """Interrupt each call of a user's code in this block after some seconds: it only serves people who watch."""
    _for_watchers.append(seconds)
    try:
        yield
    finally:
        _for_watchers.pop()


class _TooLongError(BaseException):
    """A call was interrupted; no `except Exception` of a user's code holds it up."""


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Interrupt this block after some seconds; only the main thread can be interrupted, and only in Python code."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: Any) -> None:
        raise _TooLongError(f"it took longer than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


class _Exits:
    """Stands for `os._exit`, from the first call of a user's code on."""

    really: Final = os._exit

    @classmethod
    def watch(cls, name: str) -> None:
        """Name the environment to which this process's exits belong."""
        if getattr(os._exit, "args", None) != (watched := (name, os.getpid())):
            os._exit = partial(cls._exit, *watched)

    @classmethod
    def _exit(cls, name: str, process: int, status: int) -> NoReturn:
        if os.getpid() != process:  # a fork, which may end as it likes
            cls.really(status)
        if Guard.running is not None and threading.current_thread() is threading.main_thread():
            raise SystemExit(status)
        log(f"{name}: a thread of it ended the program with os._exit({status}).")
        cls.really(1)


def end_process(code: int) -> NoReturn:
    """End this process at once, whatever its main thread does."""
    _Exits.really(code)


class _Settings(NamedTuple):
    """What a user's code may set for the whole process."""

    numpy: dict[str, Any]
    torch: Any
    filters: list[Any]
    folder: str
    argv: list[str]

    @classmethod
    def now(cls) -> "_Settings":
        torch = sys.modules.get("torch")
        default = None if torch is None else torch.get_default_dtype()
        try:
            folder = os.getcwd()
        except OSError:  # it was removed
            folder = ""
        return cls(dict(np.geterr()), default, list(warnings.filters), folder, sys.argv)

    def apply(self, present: "_Settings") -> None:
        """Set what differs from the present settings."""
        if self.numpy != present.numpy:
            np.seterr(**self.numpy)
        if (torch := sys.modules.get("torch")) is not None:
            kind = self.torch or torch.float32
            if kind != torch.get_default_dtype():
                torch.set_default_dtype(kind)
        if self.filters != present.filters:
            warnings.resetwarnings()
            warnings.filters.extend(self.filters)  # type: ignore[attr-defined]  # typeshed calls it a sequence
        if self.folder and self.folder != present.folder:
            os.chdir(self.folder)
        sys.argv = self.argv


_theirs: list[_Settings] = []
"""What users' code in this process has set so far; at most one."""


def _handlers() -> tuple[dict[int, Any], set[int]]:
    """Return the handlers of SIGNALS and the blocked signals; only the main thread can put them back."""
    if threading.current_thread() is not threading.main_thread():
        return {}, set()
    return {number: getsignal(number) for number in SIGNALS}, set(signal.pthread_sigmask(signal.SIG_BLOCK, ()))


def _restore(handlers: tuple[dict[int, Any], set[int]]) -> None:
    present = _handlers()
    if present == handlers:
        return
    for number, handler in handlers[0].items():
        if present[0][number] is not handler:
            signal.signal(number, handler)
    if present[1] != handlers[1]:
        signal.pthread_sigmask(signal.SIG_SETMASK, handlers[1])


def _said(error: BaseException) -> str:
    """Return the text of a user's exception, cut to LONGEST characters."""
    try:
        text = str(error)
    except BaseException as worse:  # a user's __str__ may raise anything
        text = f"(its text raised {type(worse).__name__})"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def _own_traceback(error: BaseException) -> str:
    """Return the traceback without this package's frames, and without lines that are too long for a screen."""
    whole = traceback.TracebackException.from_exception(error)
    hidden = __file__, importlib.__file__
    own = [part for part in whole.stack if part.filename not in hidden and not part.filename.startswith("<frozen")]
    whole.stack = traceback.StackSummary.from_list(own)
    return "".join(line if len(line) <= LONGEST else f"{line[:LONGEST]}...\n" for line in whole.format())


def _are_unique(names: Sequence[Any]) -> bool:
    return all(isinstance(name, Hashable) for name in names) and len(set(names)) == len(names)


def _are_mappings(found: Any, count: int | None = None) -> bool:
    if not isinstance(found, tuple | list) or count not in (None, len(found)):
        return False
    return {*map(type, found)} <= {dict} or all(isinstance(part, Mapping) for part in found)
