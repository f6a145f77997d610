"""Pictures of the studies, made from their results alone. Every colour goes with a line style or a mark of its own."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from common.team import COLLECTION, COMMUNICATION, MONITORING
from deploy.figures import DPI, OTHER_COLOURS, TEXT, smooth
from deploy.studies.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_MEMBERS, REWARD_BY_UAVS
from deploy.studies.statistics import LEVEL
from rollout.palette import LABELS

LINES: Final = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKS: Final = ("o", "s", "^", "D", "v", "P")
GRID: Final = 200
"""Episodes at which the seeds' curves are averaged."""

Results = Mapping[str, Any]
Panel = tuple[str, Callable[[Results], Sequence[float]]]


def save_comparison(data: Results, folder: Path) -> list[str]:
    """Draw curves, curves of each type and final scores of methods side by side; return the files' names."""
    panels: list[Panel] = [
        ("reward per agent", lambda curve: curve["reward"]["mean"]),
        ("mean AoI, units", lambda curve: curve["aoi"]),
        ("mean VDF, units", lambda curve: curve["vdf"]),
    ]
    types: list[Panel] = [
        (f"reward, {LABELS[name]}", _reward_of(name)) for name in (COMMUNICATION, MONITORING, COLLECTION)
    ]
    best = data["references"]["best"]
    level = data["references"]["policies"][best]
    levels = [level["reward"], level["figures"]["aoi"], level["figures"]["vdf"]]
    _curves(data["methods"], panels, levels, best).savefig(folder / "curves.png", dpi=DPI)
    levels = [level["types"][name] for name in (COMMUNICATION, MONITORING, COLLECTION)]
    _curves(data["methods"], types, levels, best).savefig(folder / "types.png", dpi=DPI)
    _scores(data["methods"]).savefig(folder / "scores.png", dpi=DPI)
    return ["curves.png", "types.png", "scores.png"]


def _reward_of(kind: str) -> Callable[[Results], Sequence[float]]:
    def values(curve: Results) -> Sequence[float]:
        found: Sequence[float] = curve["reward"][kind]
        return found

    return values


def save_ensemble(data: Results, folder: Path) -> list[str]:
    """Draw the reward against k_s beside the paper's; return the files' names."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    found = {int(name.rpartition(" ")[2]): method["reward"] for name, method in data["methods"].items()}
    _beside(axes, found, REWARD_BY_MEMBERS, "reward per agent")
    axes.set_xlabel("members of the shared ensemble critic, k_s")
    axes.set_xticks(sorted({*found, *REWARD_BY_MEMBERS}))
    axes.legend(frameon=False, **TEXT)
    figure.savefig(folder / "members.png", dpi=DPI)
    return ["members.png"]


def save_scalability(data: Results, folder: Path) -> list[str]:
    """Draw reward and decision time against the number of UAVs beside the paper's; return the files' names."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    _beside(left, {int(n): team["reward"] for n, team in data["teams"].items()}, REWARD_BY_UAVS, "reward per agent")
    _logarithmic(left, sorted({*REWARD_BY_UAVS, *map(int, data["teams"])}))
    _times(right, {int(n): team["time"] for n, team in data["teams"].items()})
    for axes in (left, right):
        axes.set_xlabel("UAVs")
    left.legend(frameon=False, **TEXT)
    _below(figure, right)
    figure.savefig(folder / "uavs.png", dpi=DPI)
    return ["uavs.png"]


def save_inference(data: Results, folder: Path) -> list[str]:
    """Draw decision times by number of UAVs and by method beside the paper's; return the files' names."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    _times(left, {int(n): times for n, times in data["teams"].items()})
    left.set(xlabel="UAVs")
    left.set_title("EIA-SEC", fontsize=10)
    _below(figure, left)
    names = list(data["methods"])
    right.plot(names, [INFERENCE_BY_METHOD[name] for name in names], "x", color="0.35", markersize=8)
    for index, piece in enumerate(_PIECES):
        values = [data["methods"][name][piece] for name in names]
        right.plot(names, values, MARKS[index], color=OTHER_COLOURS[index], markersize=8)
    right.set(yscale="log", ylabel="ms for each time step")
    right.set_title("12 UAVs", fontsize=10)
    right.grid(True, color="0.9")
    right.spines[["top", "right"]].set_visible(False)
    right.margins(y=0.15)
    figure.savefig(folder / "times.png", dpi=DPI)
    return ["times.png"]


_PIECES: Final = {
    "separate": "one torch network after another",
    "decide": "all actors stacked, as flown here",
    "simulate": "the simulator's step",
}


def _curves(methods: Results, panels: Sequence[Panel], levels: Sequence[float], best: str) -> Figure:
    """Draw each panel against training episodes: mean over the seeds, smoothed, and the range of the seeds."""
    figure = Figure(figsize=(4.4 * len(panels), 4.2), layout="constrained")
    for axes, (label, values), level in zip(figure.subplots(1, len(panels)), panels, levels, strict=True):
        for index, (name, method) in enumerate(methods.items()):
            _seeds(axes, method["runs"], values, index, name)
        axes.axhline(level, color="0.4", linestyle=(0, (2, 2)), linewidth=1.0, label=f"{best} (no learning)")
        axes.set(xlabel="training episodes", title=label)
        axes.title.set_fontsize(10)
        axes.grid(True, color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
    handles = figure.axes[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=len(methods) + 1, frameon=False, **TEXT)
    return figure


def _seeds(
    axes: Axes,
    runs: Sequence[Results],
    values: Callable[[Results], Sequence[float]],
    index: int,
    name: str,
) -> None:
    whole = [run for run in runs if not run["diverged"]] or [run for run in runs if run["curve"]["episodes"]]
    if not whole:
        return
    end = min(run["curve"]["episodes"][-1] for run in whole)
    grid = np.linspace(max(run["curve"]["episodes"][0] for run in whole), end, GRID)
    curves = [
        np.interp(grid, run["curve"]["episodes"], smooth(np.array(values(run["curve"]), np.float64))) for run in whole
    ]
    colour, line = OTHER_COLOURS[index % len(OTHER_COLOURS)], LINES[index % len(LINES)]
    lost = len(runs) - sum(not run["diverged"] for run in runs)
    label = name + (f" ({lost} of {len(runs)} diverged)" if lost else "")
    axes.fill_between(grid, np.min(curves, axis=0), np.max(curves, axis=0), color=colour, alpha=0.15, linewidth=0)
    axes.plot(grid, np.mean(curves, axis=0), color=colour, linestyle=line, linewidth=1.8, label=label)


def _scores(methods: Results) -> Figure:
    """Draw the interquartile mean of each method's normalised score with its interval."""
    figure = Figure(figsize=(7.0, 0.5 * len(methods) + 1.4), layout="constrained")
    axes = figure.subplots()
    for row, (name, method) in enumerate(reversed(list(methods.items()))):
        value, low, high = method["normalised"]
        index = len(methods) - 1 - row
        colour = OTHER_COLOURS[index % len(OTHER_COLOURS)]
        axes.plot([low, high], [row, row], color=colour, linewidth=4, alpha=0.5, solid_capstyle="butt")
        axes.plot(value, row, MARKS[index % len(MARKS)], color=colour, markersize=7)
        axes.annotate(f"{value:.2f}", (value, row), (0, 8), textcoords="offset points", ha="center", **TEXT)
        axes.text(-0.01, row, name, transform=axes.get_yaxis_transform(), ha="right", va="center", **TEXT)
    for end in (0.0, 1.0):
        axes.axvline(end, color="0.4", linestyle=(0, (2, 2)), linewidth=1.0)
    axes.set(
        yticks=[],
        ylim=(-0.6, len(methods) - 0.3),
        xlabel=f"normalised score, interquartile mean and {LEVEL:.0%} interval (0 random, 1 best heuristic)",
    )
    axes.xaxis.label.set_fontsize(9)
    axes.grid(True, axis="x", color="0.9")
    axes.spines[["top", "right", "left"]].set_visible(False)
    return figure


def _beside(axes: Axes, found: Mapping[int, Sequence[float]], paper: Mapping[int, float], label: str) -> None:
    """Draw our intervals and the paper's numbers over the same numbers."""
    x = sorted(found)
    value, low, high = np.array([found[number] for number in x]).T
    axes.plot(list(paper), list(paper.values()), "x--", color="0.35", label="paper", markersize=6)
    axes.errorbar(
        x, value, (value - low, high - value), fmt="o-", color=OTHER_COLOURS[0], capsize=3, label="ours", markersize=6
    )
    axes.set_ylabel(label)
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)


def _times(axes: Axes, teams: Mapping[int, Results]) -> None:
    x = sorted(teams)
    axes.plot(list(INFERENCE_BY_UAVS), list(INFERENCE_BY_UAVS.values()), "x--", color="0.35", label="paper")
    for index, (piece, label) in enumerate(_PIECES.items()):
        milliseconds = [teams[number][piece] for number in x]
        colour, line = OTHER_COLOURS[index], LINES[index]
        axes.plot(x, milliseconds, marker=MARKS[index], color=colour, linestyle=line, label=label)
    axes.set(yscale="log", ylabel="ms for each time step")
    _logarithmic(axes, sorted({*INFERENCE_BY_UAVS, *x}))
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)


def _below(figure: Figure, axes: Axes) -> None:
    """Put the legend of one of the figure's axes under it."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, **TEXT)


def _logarithmic(axes: Axes, ticks: Sequence[int]) -> None:
    axes.set_xscale("log")
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", which="minor", length=0)
