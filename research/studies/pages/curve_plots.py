"""Curves of a study's methods: of training, and of the noise-free evaluations on the way.

Each quantity stands twice: whole, and enlarged to what the second half of the runs needs, where methods lie so close
that the first episodes would hide what shows them apart. The axes are those of the methods that live. One whose runs
have all diverged goes out of bounds and is marked where it leaves.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING
from eia_sec.deploy.reports.intervals import Numbers
from eia_sec.deploy.reports.plots import SMOOTH_SHARE, TEXT, bare, look, smooth
from eia_sec.rollout.rendering.palette import LABELS
from research.studies.scales import CHOICE_FARM, SCALES

Results = Mapping[str, Any]

WIDTH: Final = 9.0
"""Inches; a page of about 900 pixels then shows letters of 9 points in 12 pixels."""
GRID: Final = 200
"""Episodes at which the seeds' curves are averaged."""
LATE: Final = 0.5
"""Share of the episodes behind which the enlarged panels show everything."""
MARGIN: Final = 0.05
"""Share of an axis that stays free at either end."""

TRAINING_PANELS: Final = {
    "reward per agent": ("reward", "mean"),
    "mean AoI, units": ("aoi",),
    "mean VDF, units": ("vdf",),
}
"""Where a run's curve holds what the panels show, by their labels."""
TYPE_PANELS: Final = {
    f"reward per UAV,\n{LABELS[name]}": ("reward", name) for name in (COMMUNICATION, MONITORING, COLLECTION)
}
CHECK_PANELS: Final = {label: (path[0],) for label, path in TRAINING_PANELS.items()}
"""The same for what a run's evaluations on the way hold."""


@dataclass(frozen=True)
class Curve:
    """The course of one method's runs.

    Attributes:
        label: the method's name, and how many runs it lost.
        episodes: [P] training episodes.
        values: [S, P] one row for each seed.
        diverged: whether all runs diverged; otherwise those that did are left out.
    """

    label: str
    episodes: Numbers
    values: Numbers
    diverged: bool


Measure = Callable[[Sequence[Results], Sequence[str]], tuple[Numbers, Numbers]]
"""Takes runs and where a quantity stands; returns episodes [P] and values [S, P], P = 0 when there are none."""


def training_figure(data: Results, panels: Mapping[str, Sequence[str]] = TRAINING_PANELS) -> Figure:
    """Return the training curves of all methods: what was earned with exploration noise on the farms of training."""
    farms = SCALES[data["scale"]].base().rollout.train_farms
    note = (
        f"While training: farms 0..{farms - 1}, with exploration noise. Line: mean of {seeds(data)}, each smoothed "
        f"by\na moving mean over {SMOOTH_SHARE:.0%} of its curve; band: range of the seeds."
    )
    return curves_figure(runs_by_name(data), panels, smoothed, note)


def checks_figure(data: Results) -> Figure:
    """Return the noise-free evaluations of all methods on the way, all on the same farms."""
    farms = f"{CHOICE_FARM}..{CHOICE_FARM + data['sizes']['choice_farms'] - 1}"
    note = (
        f"Evaluated on the way without noise: farms {farms}, neither trained on nor reported. Points: mean over farms\n"
        f"and {seeds(data)}; band: range of the seeds."
    )
    # Teams of different sizes are far apart at the end, too, so that nothing would be enlarged.
    return curves_figure(runs_by_name(data), CHECK_PANELS, evaluated, note, marked=True, enlarged="teams" not in data)


def curves_figure(
    methods: Mapping[str, Sequence[Results]],
    panels: Mapping[str, Sequence[str]],
    measure: Measure,
    note: str,
    *,
    marked: bool = False,
    enlarged: bool = True,
) -> Figure:
    """Return a panel for each quantity, and another beside it that enlarges what the second half needs.

    Args:
        methods: the runs of each method, as the results of a study keep them.
        panels: where a quantity stands, by its label.
        measure: reads a quantity off runs.
        note: what lines and bands are.
        marked: whether points have marks.
        enlarged: without it there are no panels beside, and those of all quantities stand in one row.
    """
    shape = (len(panels), 2) if enlarged else (1, len(panels))
    figure = Figure(figsize=(WIDTH, (2.2 if enlarged else 2.6) * shape[0] + 1.4), layout="constrained")
    grid = figure.subplots(*shape, sharex=True, squeeze=False)
    for place, (label, path) in enumerate(panels.items()):
        curves = [_curve(name, runs, path, measure) for name, runs in methods.items()]
        whole = grid[place, 0] if enlarged else grid[0, place]
        _panel(whole, curves, 0.0, marked=marked)
        whole.set_ylabel(label)
        if enlarged:
            _panel(grid[place, 1], curves, LATE, marked=marked)
    if enlarged:
        grid[0, 0].set_title("from the first episode on", fontsize=10)
        grid[0, 1].set_title("enlarged to the range of the second half", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("training episodes")
    figure.suptitle(note, x=0.01, ha="left", **TEXT)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    columns = 3 if max(map(len, labels)) > 24 else 6 if len(labels) <= 6 else 4
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False, **TEXT)
    return figure


def _panel(axes: Axes, curves: Sequence[Curve], late: float, *, marked: bool) -> None:
    """Draw curves on axes that hold the methods that live; behind a share of the episodes, those alone."""
    for index, curve in enumerate(curves):
        if late == 0.0 or not curve.diverged:
            _draw(axes, curve, look(index) if marked else look(index) | {"marker": ""})
    axes.set_ylim(*limits(curves, late))
    if late == 0.0:
        for curve, line in zip(curves, list(axes.lines), strict=True):
            if curve.diverged:
                _mark_exit(axes, curve, str(line.get_color()))
    axes.set_xlim(left=0.0)
    bare(axes)


def runs_by_name(data: Results) -> dict[str, Sequence[Results]]:
    """Return the trained runs of each method, or of each size of team, that the results of a study hold."""
    if "teams" in data:
        return {f"{uavs} UAVs": team["runs"] for uavs, team in data["teams"].items()}
    return {name: method["runs"] for name, method in data["methods"].items()}


def seeds(data: Results) -> str:
    """Return how many seeds each method has, in words."""
    counts = {len(runs) for runs in runs_by_name(data).values()}
    if counts == {1}:
        return "1 seed"
    return f"{' to '.join(str(count) for count in sorted({min(counts), max(counts)}))} seeds"


def smoothed(runs: Sequence[Results], path: Sequence[str]) -> tuple[Numbers, Numbers]:
    """Return training curves, smoothed, at episodes that all runs have."""
    curves = [run["curve"] for run in runs if run["curve"]["episodes"]]
    if not curves:
        return np.empty(0), np.empty((0, 0))
    first, last = max(curve["episodes"][0] for curve in curves), min(curve["episodes"][-1] for curve in curves)
    grid = np.linspace(first, last, GRID)
    rows = [np.interp(grid, curve["episodes"], smooth(np.array(_at(curve, path), np.float64))) for curve in curves]
    return grid, np.array(rows)


def evaluated(runs: Sequence[Results], path: Sequence[str]) -> tuple[Numbers, Numbers]:
    """Return the evaluations on the way as they are; seeds that were evaluated at other episodes are interpolated."""
    held = [run["checks"] for run in runs if run["checks"]]
    if not held:
        return np.empty(0), np.empty((0, 0))
    episodes = np.array([check["episodes"] for check in min(held, key=len)], np.float64)
    rows = [
        np.interp(episodes, [check["episodes"] for check in checks], [_at(check, path) for check in checks])
        for checks in held
    ]
    return episodes, np.array(rows)


def limits(curves: Sequence[Curve], late: float) -> tuple[float, float]:
    """Return the ends of an axis that holds every seed of the methods that live, behind a share of the episodes.

    Where none lives, it holds those that diverged.
    """
    drawn = [curve for curve in curves if curve.episodes.size]
    live = [curve for curve in drawn if not curve.diverged] or drawn
    held = [curve.values[:, curve.episodes >= late * curve.episodes[-1]] for curve in live]
    if not held:
        return 0.0, 1.0
    low, high = min(float(values.min()) for values in held), max(float(values.max()) for values in held)
    free = MARGIN * (high - low) or MARGIN
    return low - free, high + free


def _curve(name: str, runs: Sequence[Results], path: Sequence[str], measure: Measure) -> Curve:
    whole = [run for run in runs if not run["diverged"]]
    episodes, values = measure(whole or runs, path)
    lost = len(runs) - len(whole)
    early = "" if episodes.size else " before the first point"
    label = name + (f" ({lost} of {len(runs)} diverged{early})" if lost else "")
    return Curve(label, episodes, values, not whole)


def _draw(axes: Axes, curve: Curve, style: Mapping[str, Any]) -> None:
    """Draw the mean over the seeds and their range; a method without points has a line in the legend alone."""
    mean: Sequence[float] | Numbers = []
    if curve.episodes.size:
        low, high, mean = curve.values.min(axis=0), curve.values.max(axis=0), curve.values.mean(axis=0)
        axes.fill_between(curve.episodes, low, high, color=style["color"], alpha=0.15, linewidth=0)
    axes.plot(curve.episodes, mean, **style, markersize=3.5, linewidth=1.6, label=curve.label)


def _mark_exit(axes: Axes, curve: Curve, colour: str) -> None:
    """Mark where the mean of a diverged method leaves the axes for good, or else its end, and write its value."""
    if not curve.episodes.size:
        return
    mean, (low, high) = curve.values.mean(axis=0), axes.get_ylim()
    inside = np.flatnonzero((mean >= low) & (mean <= high))
    at = min(int(inside[-1]) + 1 if inside.size else 0, mean.size - 1)
    mark = "v" if mean[at] < low else "^" if mean[at] > high else "X"
    y = float(np.clip(mean[at], low, high))
    axes.plot(curve.episodes[at], y, mark, color=colour, markersize=8, clip_on=False, zorder=5)
    axes.annotate(
        f"diverged: {mean[-1]:.{0 if abs(mean[-1]) >= 100.0 else 1}f} at episode {curve.episodes[-1]:.0f}",
        (curve.episodes[-1], y),
        (9, 8 if mean[at] <= high else -8),
        textcoords="offset points",
        va="center",
        **TEXT,
    )


def _at(held: Results, path: Sequence[str]) -> Any:
    """Return what stands in a curve, or in an evaluation, under names one within the other."""
    found: Any = held
    for name in path:
        found = found[name]
    return found
