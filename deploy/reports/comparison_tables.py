"""Tables of several evaluations, for the terminal and for Markdown."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

from eia_sec.rollout.evaluation import Evaluation


def comparison_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return the evaluations as a table for the terminal, best reward first."""
    table = Table(title=_title(evaluations), box=SIMPLE_HEAD, padding=0, show_edge=False)
    # Where the terminal is too narrow, the path of a policy's file goes over several lines, and the numbers stay whole.
    policy, *numbers = _columns(evaluations)
    table.add_column(policy, overflow="fold")
    for name in numbers:
        table.add_column(name.replace(", ", "\n"), justify="right", no_wrap=True)
    for row in _rows(evaluations):
        table.add_row(*row)
    return table


def comparison_markdown(evaluations: Sequence[Evaluation]) -> str:
    """Return the evaluations as a Markdown table, best reward first."""
    columns = _columns(evaluations)
    lines = [columns, ["---", *["---:"] * (len(columns) - 1)], *_rows(evaluations)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _columns(evaluations: Sequence[Evaluation]) -> list[str]:
    """Return the headings: reward of all agents and of each type, then the metrics or the episode length."""
    first, environment = evaluations[0].total, evaluations[0].environment
    metrics = [metric.label for metric in environment.episode_metrics] or ["steps"]
    return ["policy", "reward", *(environment.short_names.get(name, name) for name in first.types), *metrics]


def _rows(evaluations: Sequence[Evaluation]) -> list[list[str]]:
    largest = max(abs(evaluation.total.reward) for evaluation in evaluations)
    digits = 0 if largest >= 100.0 else 2
    return [
        [
            evaluation.policy,
            *(f"{value:.{digits}f}" for value in (total.reward, *total.types.values())),
            *(
                [metric.text(total.metrics[metric.name]) for metric in evaluation.environment.episode_metrics]
                or [f"{total.steps:.0f}"]
            ),
        ]
        for evaluation in sorted(evaluations, key=lambda item: -item.total.reward)
        for total in [evaluation.total]
    ]


def _title(evaluations: Sequence[Evaluation]) -> str:
    """Return the sample that the means cover, if it is the same for all evaluations."""
    conditions = {(evaluation.farms, evaluation.episodes) for evaluation in evaluations}
    if len(conditions) != 1:
        return "mean per episode"
    farms, episodes = conditions.pop()
    flown = f"{episodes} episode" + ("s" if episodes > 1 else "")
    return f"mean over {len(farms)} farm{'s' if len(farms) > 1 else ''}, {flown} each"
