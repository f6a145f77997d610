"""The budget of the comparison on simple_spread, for the scripts of all programs. Standard library only."""

import argparse
from collections.abc import Sequence
from typing import Any, Final

EPISODE_STEPS: Final = 25
NOISE: Final = 0.3
"""Standard deviation of the Gaussian exploration noise on actions in -1..1."""
POINTS: Final = 50
"""Points of a curve."""


def spread_options(software: str, algorithms: Sequence[str]) -> argparse.ArgumentParser:
    """Return the command line that all scripts understand."""
    parser = argparse.ArgumentParser(description=f"What {software} reaches on simple_spread.")
    parser.add_argument("--algorithm", choices=algorithms, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True, help="learning rate of actors and critics")
    parser.add_argument("--steps", type=int, required=True, help="environment steps")
    parser.add_argument("--every", type=int, required=True, help="environment steps for each update")
    parser.add_argument("--warmup", type=int, required=True, help="environment steps of random actions at first")
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--capacity", type=int, default=65_536)
    parser.add_argument("--discount", type=float, default=0.95)
    parser.add_argument("--target-rate", type=float, default=0.005)
    parser.add_argument("--noise", type=float, default=NOISE, help="deviation of the exploration, actions in -1..1")
    parser.add_argument("--scenarios", type=int, nargs="+", required=True, help="environment seeds of the evaluation")
    return parser


def curve(episodes: Sequence[float]) -> dict[str, list[Any]]:
    """Return the means over equal parts of training: environment steps at a part's end, and reward of its episodes."""
    ends = [len(episodes) * (k + 1) // POINTS for k in range(POINTS)]
    parts = [episodes[start:end] for start, end in zip([0, *ends[:-1]], ends, strict=True)]
    kept = [(end * EPISODE_STEPS, sum(part) / len(part)) for part, end in zip(parts, ends, strict=True) if part]
    return {"environment_steps": [step for step, _ in kept], "reward": [round(value, 3) for _, value in kept]}
