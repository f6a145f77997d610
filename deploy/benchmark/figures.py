"""Pictures of a benchmark. Every colour goes with a line style or a mark of its own."""

from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from eia_sec.deploy.benchmark.page import PICTURES
from eia_sec.deploy.benchmark.scores import Scores, final
from eia_sec.deploy.reports.intervals import LEVEL, Interval
from eia_sec.deploy.reports.plots import DPI, TEXT, bare, look

COLUMNS: Final = 3
"""Panels in a row."""


def save_pictures(scores: Scores, folder: Path) -> None:
    """Draw PICTURES; raise OSError if one cannot be written."""
    for name, figure in zip(PICTURES, (curves_figure(scores), scores_figure(scores)), strict=True):
        figure.savefig(folder / name, dpi=DPI)


def curves_figure(scores: Scores) -> Figure:
    """Return the returns by environment steps: interquartile mean and interval, a panel for each environment."""
    environments = scores.plan.environments
    figure, panels = _panels(len(environments), 3.4)
    for axes, environment in zip(panels, environments, strict=True):
        for index, algorithm in enumerate(scores.plan.algorithms):
            steps, (value, low, high) = scores.curve(algorithm, environment)
            axes.fill_between(steps, low, high, color=look(index)["color"], alpha=0.15, linewidth=0)
            axes.plot(steps, value, **look(index), markersize=3.5, label=algorithm)
        axes.axhline(scores.random(environment), color="0.4", linestyle=(0, (2, 2)), linewidth=1.0, label="random")
        axes.set_title(environment, loc="left", **TEXT)
        axes.set_xlabel("environment steps")
        axes.set_xlim(left=0.0)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    return _finished(figure, panels, scores, "reward per agent and episode")


def scores_figure(scores: Scores) -> Figure:
    """Return the returns of the policies at the end, a panel for each environment, and one for all of them."""
    plan = scores.plan
    several = len(plan.environments) > 1
    figure, panels = _panels(len(plan.environments) + several, 0.3 * len(plan.algorithms) + 1.6)
    for axes, environment in zip(panels, plan.environments, strict=False):
        found = [scores.interval(algorithm, environment, final) for algorithm in plan.algorithms]
        _bars(axes, plan.algorithms, found)
        axes.axvline(scores.random(environment), color="0.4", linestyle=(0, (2, 2)), linewidth=1.0, label="random")
        axes.set_title(environment, loc="left", **TEXT)
        axes.set_xlabel("reward per agent and episode")
    if several:
        _bars(panels[-1], plan.algorithms, [scores.normalised(algorithm, final) for algorithm in plan.algorithms])
        panels[-1].set_title("all environments", loc="left", **TEXT)
        panels[-1].set_xlabel("normalised: 0 is the lowest episode, 1 the highest")
    return _finished(figure, panels, scores, "")


def _bars(axes: Axes, names: tuple[str, ...], found: list[Interval | None]) -> None:
    """Draw a mark and the bar of its interval in a row for each name."""
    for row, one in enumerate(found):
        assert one is not None  # every policy has an end
        axes.plot(
            [one.low, one.high], [row, row], color=look(row)["color"], linewidth=5, alpha=0.4, solid_capstyle="butt"
        )
        axes.plot(one.value, row, **look(row), markersize=7)
    axes.set_yticks(range(len(names)), list(names))
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(names) - 0.5, -0.5)


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    columns = min(count, COLUMNS)
    rows = -(-count // columns)
    figure = Figure(figsize=(max(6.4, 4.4 * columns), height * rows + 0.8), layout="constrained")
    grid = list(figure.subplots(rows, columns, squeeze=False).flat)
    for spare in grid[count:]:
        spare.remove()
    return figure, grid[:count]


def _finished(figure: Figure, panels: list[Axes], scores: Scores, label: str) -> Figure:
    for axes in panels:
        bare(axes)
    panels[0].set_ylabel(label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, **TEXT)
    seeds = scores.plan.seeds
    note = f"interquartile mean and {LEVEL:.0%} interval over {seeds} seed{'' if seeds == 1 else 's'}"
    figure.suptitle(note, x=0.01, ha="left", **TEXT)
    return figure
