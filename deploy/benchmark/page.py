"""The page of a benchmark: tables in Markdown, pictures, and what made it."""

import shlex
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from eia_sec.deploy.benchmark.scores import Returns, Scores, absolute, final, sampled
from eia_sec.deploy.benchmark.trainings import FINAL_TIMES, RANDOM
from eia_sec.deploy.local.code_options import code_options
from eia_sec.deploy.reports.intervals import LEVEL, Interval

DATA: Final = "marl_eval.json"
PICTURES: Final = {
    "curves.png": "Reward per agent and episode by environment steps",
    "scores.png": "Reward per agent and episode of the policies at the end",
}
"""The pictures, and what they show."""
COLUMNS: Final[Mapping[str, Returns]] = {"at the end": final, "drawn actions": sampled, "best on the way": absolute}
FEW_SEEDS: Final = 5
"""Seeds below which a page says that intervals are too narrow."""


def page(scores: Scores, made: Mapping[str, Any], options: Sequence[str]) -> str:
    """Return the page.

    Args:
        scores: what all trainings have come to.
        made: command, commit and versions, see `eia_sec.deploy.reports.provenance.made_by`.
        options: what `eia-sec train` takes for settings that the benchmark was given.
    """
    plan = scores.plan
    lines = ["# Benchmark", "", *_explained(scores), ""]
    for environment in plan.environments:
        lines += [f"## {environment}", "", *environment_table(scores, environment), ""]
    if len(plan.environments) > 1:
        lines += ["## All environments", "", *overall_table(scores), ""]
    for name, shown in PICTURES.items():
        lines += [f"![{shown}]({name})", ""]
    packages = ", ".join(f"{name} {version}" for name, version in made["packages"].items())
    lines += ["## Made by", "", "```sh", made["command"], "```", ""]
    lines += [f"Commit {made['commit']}, Python {made['python']}, {packages}.", ""]
    lines += [
        "Each run learns as this one does, until its steps are used up:",
        "",
        "```sh",
        _training(scores, options),
        "```",
    ]
    return "\n".join([*lines, ""])


def environment_table(scores: Scores, environment: str) -> list[str]:
    """Return the table of one environment, an algorithm a row, the best at the end first."""
    plan = scores.plan
    cells = {
        name: [scores.interval(name, environment, returns) for returns in COLUMNS.values()] for name in plan.algorithms
    }
    rows = [
        (name, *map(_cell, cells[name]), f"{_median(scores, name, environment) / 60.0:.1f}")
        for name in sorted(plan.algorithms, key=lambda name: -_value(cells[name][0]))
    ]
    rows.append((RANDOM, f"{scores.random(environment):.2f}", "", "", ""))
    return _table(("algorithm", *COLUMNS, "minutes a run"), rows)


def overall_table(scores: Scores) -> list[str]:
    """Return the table over all environments, the best at the end first."""
    found = {name: [scores.normalised(name, one) for one in (final, absolute)] for name in scores.plan.algorithms}
    rows = [(name, *map(_cell, found[name])) for name in sorted(found, key=lambda name: -found[name][0].value)]
    return _table(("algorithm", "at the end, normalised", "best on the way, normalised"), rows)


def _explained(scores: Scores) -> list[str]:
    """Return what the numbers are."""
    plan, first = scores.plan, scores.plan.trainings[0]
    measuring = first.measuring
    taken = [point.step_count for one in plan.trainings for point in scores.result(one).points[-1:]]
    steps = f"{min(taken):,} to {max(taken):,}" if min(taken) < max(taken) else f"{min(taken):,}"
    lines = [
        f"{plan.seeds} seeds of every algorithm. Each run took {steps} environment steps, those of imitation included. "
        f"Values are rewards per agent and episode on {FINAL_TIMES * measuring.scenarios} scenarios that training "
        f"never saw: the interquartile mean over the seeds, and in brackets the {LEVEL:.0%} interval of a stratified "
        "bootstrap.",
        "",
        "- *at the end*: the policy with which the run ended, by its likeliest actions;",
        "- *drawn actions*: the same policy, by actions drawn from its distribution, as in training;",
        f"- *best on the way*: the best of {measuring.points} policies along the run, chosen on {measuring.scenarios} "
        "other scenarios. marl-eval calls it the absolute metric.",
    ]
    if len(plan.environments) > 1:
        lines += [
            "",
            "Normalised, 0 is the lowest and 1 the highest reward of any algorithm's episode in an environment; its "
            "interval draws the seeds of each environment apart, as rliable does.",
        ]
    if plan.seeds < FEW_SEEDS:
        lines += ["", f"With fewer than {FEW_SEEDS} seeds the intervals are too narrow to compare algorithms by."]
    return lines


def _training(scores: Scores, options: Sequence[str]) -> str:
    """Return the command of the first algorithm, environment and seed; the others differ in these alone."""
    config = scores.plan.trainings[0].config
    words = ["eia-sec", "train", "--lockstep", *code_options(config), *options]
    words += ["--algorithm", config.algorithm.name, "--seed", str(config.seed), "--steps", str(config.steps)]
    return shlex.join(words)


def _median(scores: Scores, algorithm: str, environment: str) -> float:
    """Return the median time of training, s."""
    return float(np.median([result.points[-1].seconds for result in scores.by_seed(algorithm, environment)]))


def _cell(found: Interval | None) -> str:
    return "" if found is None else f"{found.value:.2f} ({found.low:.2f} to {found.high:.2f})"


def _value(found: Interval | None) -> float:
    return -float("inf") if found is None else found.value


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    rule = "|---|" + "---:|" * (len(head) - 1)
    return [f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(row)} |" for row in rows)]
