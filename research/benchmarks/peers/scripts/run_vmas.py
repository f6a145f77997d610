"""VMAS: environment steps per second of its `discovery` scenario. Runs in the environment of requirements/vmas.txt.

With more than one process, each steps its own share of the environments in a thread of its own, and rates add up.
"""

import multiprocessing
from typing import Any

import torch
from vmas import make_env

from research.benchmarks.peers.clock import hand_over, simulator_options, step_rate

SCENARIO = "discovery"
DRAWN = 16
"""Random actions that are drawn before the clock starts and then used in turn."""


def rate(environments: int, agents: int, threads: int, seconds: float) -> float:
    """Return the environment steps per second of one process."""
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    env = make_env(SCENARIO, environments, device="cpu", continuous_actions=True, n_agents=agents, seed=0)
    env.reset()
    drawn = [[torch.rand(environments, 2) * 2 - 1 for _ in range(agents)] for _ in range(DRAWN)]
    turn = iter(range(10**12))

    def step() -> None:
        env.step(drawn[next(turn) % DRAWN])

    with torch.no_grad():
        return environments * step_rate(step, seconds)


def share(start: Any, results: Any, *arguments: Any) -> None:
    """Measure in a child process as soon as all children have come so far."""
    torch.set_num_threads(1)
    start.wait()
    results.put(rate(*arguments))


def rate_of_processes(processes: int, environments: int, agents: int, seconds: float) -> float:
    """Return the sum of the rates of processes that each step their share."""
    context = multiprocessing.get_context("spawn")
    start, results = context.Barrier(processes), context.Queue()
    arguments = (environments // processes, agents, 1, seconds)
    children = [context.Process(target=share, args=(start, results, *arguments)) for _ in range(processes)]
    for child in children:
        child.start()
    total = sum(results.get() for _ in children)
    for child in children:
        child.join()
    return float(total)


def main() -> None:
    """Measure and print."""
    options = simulator_options("VMAS").parse_args()
    lines = []
    for environments in options.batches:
        if environments < options.processes:
            continue
        if options.processes > 1:
            found = rate_of_processes(options.processes, environments, options.agents, options.seconds)
        else:
            found = rate(environments, options.agents, options.threads, options.seconds)
        lines.append(
            {
                "software": "VMAS",
                "case": SCENARIO,
                "agents": options.agents,
                "environments": environments,
                "threads": options.threads,
                "processes": options.processes,
                "env_steps_per_second": found,
            }
        )
    hand_over(lines, "vmas", "torch")


if __name__ == "__main__":
    main()
