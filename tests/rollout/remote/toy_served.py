"""A task of two agents in plain numbers; `python -m tests.rollout.remote.toy_served NAME ENDPOINT ...` serves it.

Options: `--copies N`, `--pause SECONDS` for each step, `--away SECONDS` of an outage that begins at step 10,
`--raise N` for an error at that step, `--tls FOLDER`.
"""

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import EnvironmentOutageError
from eia_sec.remote import serve


class Discrete:
    """A choice, as Gymnasium has it."""

    def __init__(self, n: int) -> None:
        self.n, self.start = n, 0


class Box:
    """Numbers within bounds, as Gymnasium has them."""

    def __init__(self, low: float, high: float, shape: tuple[int, ...]) -> None:
        self.low, self.high = np.full(shape, low, np.float32), np.full(shape, high, np.float32)
        self.shape, self.dtype = shape, np.dtype(np.float32)


class Line:
    """Agents on a line that should come to 0 in `length` steps; it needs nothing but numpy.

    Attributes:
        taken: all actions so far.
    """

    def __init__(self, length: int = 10, pause: float = 0.0, away: float = 0.0, fail: int = -1) -> None:
        self.possible_agents = ["left", "right"]
        self.agents: list[str] = []
        self.taken: list[dict[str, int]] = []
        self._length, self._pause, self._away, self._fail = length, pause, away, fail
        self._x: NDArray[np.float32] = np.zeros(2, np.float32)
        self._time, self._until = 0, 0.0

    def observation_space(self, agent: str) -> Box:
        """Return the space of position and time left."""
        return Box(-10.0, 10.0, (2,))

    def action_space(self, agent: str) -> Discrete:
        """Return the choice of left, stay and right."""
        return Discrete(3)

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode."""
        self._present()
        self._x = np.random.default_rng(seed).uniform(-1.0, 1.0, 2).astype(np.float32)
        self._time, self.agents = 0, list(self.possible_agents)
        return self._seen(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> tuple[dict[str, Any], ...]:
        """Move."""
        time.sleep(self._pause)
        self.taken.append(dict(actions))
        if len(self.taken) == self._fail:
            raise RuntimeError("the wheel has come off")
        if self._away and len(self.taken) == 10:
            self._until = time.monotonic() + self._away
        self._present()
        here = list(self.agents)
        for index, agent in enumerate(self.possible_agents):
            self._x[index] += 0.2 * (actions[agent] - 1)
        self._time += 1
        over = self._time >= self._length
        self.agents = [] if over else here
        rewards = {agent: -float(abs(self._x[index])) for index, agent in enumerate(here)}
        infos = {agent: {"time": self._time} for agent in here}
        return self._seen(), rewards, dict.fromkeys(here, False), dict.fromkeys(here, over), infos

    def close(self) -> None:
        """Do nothing."""

    def _present(self) -> None:
        if time.monotonic() < self._until:
            raise EnvironmentOutageError("the arm is in emergency stop")

    def _seen(self) -> dict[str, Any]:
        left = (self._length - self._time) / self._length
        return {agent: np.array([self._x[index], left], np.float32) for index, agent in enumerate(self.possible_agents)}


def main() -> None:
    """Serve it until the process is ended."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name")
    parser.add_argument("endpoint")
    parser.add_argument("--copies", type=int, default=1)
    parser.add_argument("--pause", type=float, default=0.0)
    parser.add_argument("--away", type=float, default=0.0)
    parser.add_argument("--raise", type=int, default=-1, dest="fail")
    parser.add_argument("--tls")
    given = parser.parse_args()
    made = [Line(25, given.pause, given.away, given.fail) for _ in range(given.copies)]
    serve(made, given.name, given.endpoint, tls=given.tls)


if __name__ == "__main__":
    main()
