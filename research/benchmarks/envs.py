"""What the standard interfaces cost over the simulator.

Run `python -m research.benchmarks.envs research/results/environment.json`.

All are timed in one process, in turns, by its processor time; the best of many short stretches counts, so that other
work on the machine matters little. Both sides fly the same actions, and no stretch contains the end of an episode.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from eia_sec.common.config.presets import preset
from eia_sec.rollout.envs.parallel_env import parallel_env
from eia_sec.rollout.envs.vector import FarmVectorEnv
from eia_sec.rollout.sim.batch import FarmBatch

SIZES: Final = (1, 8, 64, 512)
"""Numbers of environments that the vector interface is timed with."""
STRETCHES: Final = 15
"""Stretches of which the best counts."""
SECONDS: Final = 0.1
"""Processor time that a stretch takes about."""
PICTURES: Final = 40
"""Pictures that are drawn."""
WARM_UP: Final = 45
"""Steps before pictures are timed, so that trails are long and counters have risen."""


def main(arguments: list[str]) -> None:
    """Measure, and write the result to the file given, or to standard output."""
    result = {
        "command": "python -m research.benchmarks.envs",
        "vector": [_vector(size) for size in SIZES],
        "parallel": _parallel(),
        "pictures_per_second": _pictures(),
    }
    text = json.dumps(result, indent=2) + "\n"
    if arguments:
        Path(arguments[0]).write_text(text, encoding="utf-8")
    else:
        sys.stdout.write(text)


def _vector(size: int) -> dict[str, float]:
    envs, batch = FarmVectorEnv(size), FarmBatch(preset("study").farm, size)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (size, batch.team.environment_action_size)).astype(np.float32)

    def begin() -> None:
        envs.reset(seed=0, options={"farm": 0, "episode": list(range(size))})
        for index in range(size):
            batch.reset(index, 0, index)

    simulator, interface = _best(begin, lambda: batch.step(actions), lambda: envs.step(actions))
    return {
        "environments": size,
        "simulator_us": simulator * 1e6,
        "interface_us": interface * 1e6,
        "ratio": interface / simulator,
    }


def _parallel() -> dict[str, float]:
    farm, batch = parallel_env(), FarmBatch(preset("study").farm, 1)
    row = np.random.default_rng(0).uniform(-1.0, 1.0, (1, batch.team.environment_action_size)).astype(np.float32)
    actions = {name: row[0, 2 * index : 2 * index + 2] for index, name in enumerate(farm.possible_agents)}

    def begin() -> None:
        farm.reset(options={"farm": 0, "episode": 0})
        batch.reset(0, 0, 0)

    simulator, interface = _best(begin, lambda: batch.step(row), lambda: farm.step(actions))
    return {"simulator_us": simulator * 1e6, "interface_us": interface * 1e6, "ratio": interface / simulator}


def _pictures() -> float:
    farm = parallel_env(render_mode="rgb_array")
    farm.reset(seed=0)
    for _ in range(WARM_UP):
        farm.step({name: farm.action_space(name).sample() for name in farm.agents})
    farm.render()
    return 1.0 / min(_seconds(farm.render, 1) for _ in range(PICTURES))


def _best(begin: Callable[[], None], *steps: Callable[[], Any]) -> list[float]:
    """Return the least seconds of one call of each function, timed in turns over the same steps."""
    begin()
    count = max(1, min(400, int(SECONDS / _seconds(steps[0], 3))))
    least = [np.inf] * len(steps)
    for _ in range(STRETCHES):
        begin()
        for which, step in enumerate(steps):
            least[which] = min(least[which], _seconds(step, count))
    return least


def _seconds(function: Callable[[], Any], count: int) -> float:
    start = time.process_time()
    for _ in range(count):
        function()
    return max(time.process_time() - start, 1e-9) / count


if __name__ == "__main__":
    main(sys.argv[1:])
