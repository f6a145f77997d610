"""Evaluations side by side: a table for the terminal and one for a document."""

from collections.abc import Sequence
from typing import Final

from rich.box import SIMPLE_HEAD
from rich.table import Table

from rollout.evaluation import Evaluation

COLUMNS: Final = (
    "policy",
    "reward",
    "c",
    "m",
    "d",
    "AoI",
    "VDF",
    "collisions",
    "boundary",
    "energy, kJ",
)
"""Reward is the mean over all agents; c, m, d the mean over one type; collisions and boundary are UAV steps."""


def comparison_table(evaluations: Sequence[Evaluation]) -> Table:
    """Return the evaluations as a table for the terminal, best reward first."""
    table = Table(title=_title(evaluations), box=SIMPLE_HEAD, padding=0, show_edge=False)
    for name in COLUMNS:
        table.add_column(name.replace(", ", "\n"), justify="left" if name == "policy" else "right", no_wrap=True)
    for row in _rows(evaluations):
        table.add_row(*row)
    return table


def comparison_markdown(evaluations: Sequence[Evaluation]) -> str:
    """Return the evaluations as a Markdown table, best reward first."""
    lines = [list(COLUMNS), ["---", *["---:"] * (len(COLUMNS) - 1)], *_rows(evaluations)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _rows(evaluations: Sequence[Evaluation]) -> list[list[str]]:
    return [
        [
            evaluation.policy,
            *(f"{value:.0f}" for value in (total.reward, total.communication, total.monitoring, total.collection)),
            f"{total.aoi:.2f}",
            f"{total.vdf:.2f}",
            f"{total.collisions:.1f}",
            f"{total.boundary:.1f}",
            f"{total.energy_j / 1000.0:.0f}",
        ]
        for evaluation in sorted(evaluations, key=lambda item: -item.total.reward)
        for total in [evaluation.total]
    ]


def _title(evaluations: Sequence[Evaluation]) -> str:
    """Return over what the means were taken, when that is the same for all."""
    conditions = {(evaluation.farms, evaluation.episodes) for evaluation in evaluations}
    if len(conditions) != 1:
        return "mean per episode"
    farms, episodes = conditions.pop()
    flown = f"{episodes} episode" + ("s" if episodes > 1 else "")
    return f"mean over {len(farms)} farm{'s' if len(farms) > 1 else ''}, {flown} each"
