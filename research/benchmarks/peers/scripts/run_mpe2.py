"""mpe2: environment steps per second of `simple_spread_v3`. Runs in the environment of requirements/mpe2.txt.

It simulates one environment in Python; threads do not apply.
"""

import numpy as np
from mpe2 import simple_spread_v3

from research.benchmarks.peers.clock import hand_over, simulator_options, step_rate

DRAWN = 16
"""Random actions that are drawn before the clock starts and then used in turn."""
ENDLESS = 10**9


def rate(agents: int, seconds: float) -> float:
    """Return the environment steps per second of one parallel environment in a loop."""
    env = simple_spread_v3.parallel_env(N=agents, max_cycles=ENDLESS, continuous_actions=True)
    env.reset(seed=0)
    draw = np.random.default_rng(0)
    drawn = [
        {name: draw.uniform(0, 1, env.action_space(name).shape).astype(np.float32) for name in env.possible_agents}
        for _ in range(DRAWN)
    ]
    turn = iter(range(10**12))

    def step() -> None:
        env.step(drawn[next(turn) % DRAWN])

    return step_rate(step, seconds)


def main() -> None:
    """Measure and print."""
    options = simulator_options("mpe2").parse_args()
    lines = [
        {
            "software": "mpe2",
            "case": "simple_spread_v3",
            "agents": agents,
            "environments": 1,
            "threads": 1,
            "processes": 1,
            "env_steps_per_second": rate(agents, options.seconds),
        }
        for agents in sorted({3, options.agents})
    ]
    hand_over(lines, "mpe2", "pettingzoo", "numpy")


if __name__ == "__main__":
    main()
