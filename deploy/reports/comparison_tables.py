"""The table of evaluations on the same episodes, for the terminal: a column for each policy, a row for each number."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

from eia_sec.common.config import RunConfig
from eia_sec.common.farm import farm_of
from eia_sec.rollout.evaluation import Evaluation, Score


def scenario_word(config: RunConfig) -> str:
    """Return what a run's environment makes of a seed: a farm, or a scenario in other environments."""
    return "scenario" if farm_of(config) is None else "farm"


def counted(number: int, word: str) -> str:
    """Return a number with its noun."""
    return f"{number:,} {word}{'' if number == 1 else 's'}"


def comparison_table(evaluations: Sequence[Evaluation], scenario: str) -> Table:
    """Return evaluations on the same episodes as a table, in their order.

    Args:
        evaluations: at least one.
        scenario: what a seed stands for, see `scenario_word`.
    """
    first = evaluations[0]
    title = _title(first, scenario)
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    table.min_width = len(title)
    table.add_column("mean per episode", no_wrap=True)
    # Where the terminal is too narrow, the path of a policy's file goes over several lines, and the numbers stay whole.
    for evaluation in evaluations:
        table.add_column(evaluation.policy, justify="right", overflow="fold", min_width=7)
    each = [_cells(evaluation) for evaluation in evaluations]
    largest = max(abs(evaluation.total.reward) for evaluation in evaluations)
    digits = 0 if largest >= 100.0 else 2
    table.add_row("reward per agent", *(f"{evaluation.total.reward:.{digits}f}" for evaluation in evaluations))
    for name in first.total.types if len(first.total.types) > 1 else ():
        table.add_row(f"  {name}", *(f"{evaluation.total.types[name]:.{digits}f}" for evaluation in evaluations))
    for row in zip(*each, strict=True):
        table.add_row(row[0][0], *(text for _, text in row))
    return table


def _cells(evaluation: Evaluation) -> list[tuple[str, str]]:
    """Return headings and values of what is not reward: the environment's metrics, or the length of episodes."""
    total: Score = evaluation.total
    metrics = evaluation.environment.episode_metrics
    found = [(metric.heading, metric.text(total.metrics[metric.name])) for metric in metrics]
    return found or [("length, steps", f"{total.steps:.0f}")]


def _title(first: Evaluation, scenario: str) -> str:
    seeds = first.farms
    numbers = f"{seeds[0]}" if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"
    return f"{counted(len(seeds), scenario)} ({numbers}), {counted(first.episodes, 'episode')} each"
