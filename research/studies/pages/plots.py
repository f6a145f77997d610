"""Pictures of the studies, made from their results alone. Every colour goes with a line style or a mark of its own."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from eia_sec.deploy.reports.intervals import LEVEL, Numbers
from eia_sec.deploy.reports.plots import DPI, LINES, MARKS, OTHER_COLOURS, TEXT, bare
from research.studies.analysis.paper import INFERENCE_BY_METHOD, INFERENCE_BY_UAVS, REWARD_BY_MEMBERS, REWARD_BY_UAVS
from research.studies.pages.curve_plots import (
    TYPE_PANELS,
    WIDTH,
    checks_figure,
    seeds,
    training_figure,
)
from research.studies.pages.flight_plots import save_flights

RESULTS: Final = "results.json"
"""The file in a study's folder that its pictures are made from."""
MEMBERS: Final = 2
"""The k_s whose reward the others are compared with."""
LEAST_SCORE: Final = -0.25
"""Where the axis of normalised scores ends at the latest, so that one of a diverged run does not squeeze the others."""
CAPTIONS: Final = {
    "checks.png": "Evaluations without noise on the way, on farms that are neither trained on nor reported.",
    "curves.png": "Training curves: with exploration noise, on the farms of training, unlike the table. Of equal "
    "budgets those with elite imitation end earlier, because the episodes that it flies count too.",
    "types.png": "The same by type of UAV.",
    "scores.png": "What the table reports, on the unseen farms.",
    "members.png": "Reward by k_s: beside the paper's, as ratios to k_s = 2, and ours enlarged.",
    "uavs.png": "Reward and time of a decision by size of the team, beside the paper's.",
    "times.png": "Time of a decision by size of the team and by method, beside the paper's.",
    "-collected.png": "Units that each UAV has collected; one line for each UAV.",
    "-3d.png": "Paths in space, heights drawn far taller than lengths; marks are the ends of the paths.",
    ".png": "Paths of the last 100 steps from above. Sensors, plots and links are as at the end.",
}
"""What stands under a picture, by the end of its name; the first that fits."""

Results = Mapping[str, Any]


def caption(name: str) -> str:
    """Return what a picture shows, in a sentence or two, from the name of its file."""
    return next(text for end, text in CAPTIONS.items() if name.endswith(end))


def save_pictures(data: Results, folder: Path) -> list[str]:
    """Draw all pictures that the results of a study hold; return the files' names in the order of the page.

    Raises:
        OSError: a picture cannot be written.
    """
    match data["study"]:
        case "training" | "ablation" | "default" | "on_policy" | "observations":
            return save_comparison(data, folder)
        case "ensemble":
            return save_ensemble(data, folder)
        case "scalability":
            return save_scalability(data, folder)
        case "inference":
            return save_inference(data, folder)
        case _:
            return save_flights(data, folder)


def save_comparison(data: Results, folder: Path) -> list[str]:
    """Draw evaluations on the way, training curves, those of each type, and final scores of methods side by side."""
    plots = {
        "checks.png": checks_figure(data),
        "curves.png": training_figure(data),
        "types.png": training_figure(data, TYPE_PANELS),
        "scores.png": scores_figure(data),
    }
    return _saved(plots, folder)


def save_ensemble(data: Results, folder: Path) -> list[str]:
    """Draw the reward by k_s beside the paper's, and the evaluations on the way."""
    return _saved({"members.png": members_figure(data), "checks.png": checks_figure(data)}, folder)


def save_scalability(data: Results, folder: Path) -> list[str]:
    """Draw reward and decision time by number of UAVs beside the paper's, and the evaluations on the way."""
    return _saved({"uavs.png": teams_figure(data), "checks.png": checks_figure(data)}, folder)


def save_inference(data: Results, folder: Path) -> list[str]:
    """Draw decision times by number of UAVs and by method beside the paper's."""
    return _saved({"times.png": times_figure(data)}, folder)


def members_figure(data: Results) -> Figure:
    """Return the reward by k_s: beside the paper's, both as ratios to that of k_s = 2, and ours enlarged."""
    found = {int(name.rpartition(" ")[2]): method for name, method in data["methods"].items()}
    reward = {number: np.array(method["reward"]) for number, method in found.items()}
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    beside, ratio, alone = figure.subplots(1, 3)
    _beside(beside, reward, REWARD_BY_MEMBERS)
    own, theirs = float(reward[MEMBERS][0]), REWARD_BY_MEMBERS[MEMBERS]
    ratios = {number: value / theirs for number, value in REWARD_BY_MEMBERS.items()}
    _beside(ratio, {number: value / own for number, value in reward.items()}, ratios)
    _beside(alone, reward, {})
    for number, method in found.items():
        rewards = [run["reward"] for run in method["runs"]]
        label = "ours, each seed (mean over the farms)" if number == MEMBERS else None
        alone.plot([number] * len(rewards), rewards, "_", color=OTHER_COLOURS[1], markersize=9, label=label)
    labels = ("reward per agent", f"reward / reward of k_s = {MEMBERS}", "reward per agent")
    titles = ("beside the paper's", "as ratios", "ours enlarged")
    for axes, label, title in zip((beside, ratio, alone), labels, titles, strict=True):
        axes.set_title(title, fontsize=10)
        axes.set_ylabel(label)
        axes.set_xlabel("k_s, members of the ensemble")
        axes.set_xticks(sorted({*found, *REWARD_BY_MEMBERS}))
    # The last panel has our line once more; of each name the legend shows one.
    drawn = [axes.get_legend_handles_labels() for axes in (beside, alone)]
    seen = {name: handle for handles, names in drawn for handle, name in zip(handles, names, strict=True)}
    figure.legend(list(seen.values()), list(seen), loc="outside lower center", ncols=3, frameon=False, **TEXT)
    figure.suptitle(
        f"Ours: {_interval_note(data)}\nRatios: value and interval over the value of k_s = {MEMBERS}.",
        x=0.01,
        ha="left",
        **TEXT,
    )
    return figure


def teams_figure(data: Results) -> Figure:
    """Return reward and decision time against the number of UAVs beside the paper's."""
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    _beside(left, {int(n): np.array(team["reward"]) for n, team in data["teams"].items()}, REWARD_BY_UAVS)
    _logarithmic(left, sorted({*REWARD_BY_UAVS, *map(int, data["teams"])}))
    left.set(xlabel="UAVs, logarithmic", ylabel="reward per agent")
    left.legend(frameon=False, **TEXT)
    _times(right, {int(n): team["time"] for n, team in data["teams"].items()})
    _below(figure, right)
    figure.suptitle(f"Reward, ours: {_interval_note(data)}\n{_TIMES_NOTE}", x=0.01, ha="left", **TEXT)
    return figure


def times_figure(data: Results) -> Figure:
    """Return decision times by number of UAVs and by method beside the paper's."""
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _times(left, {int(n): times for n, times in data["teams"].items()})
    left.set_title("EIA-SEC", fontsize=10)
    _below(figure, left)
    names = list(data["methods"])
    right.plot(names, [INFERENCE_BY_METHOD[name] for name in names], "x", color="0.35", markersize=8)
    for index, piece in enumerate(_PIECES):
        values = [data["methods"][name][piece] for name in names]
        right.plot(names, values, MARKS[index], color=OTHER_COLOURS[index], markersize=8)
    right.set(yscale="log", xlabel="method")
    right.set_title("12 UAVs", fontsize=10)
    right.margins(x=0.12)
    bare(right)
    figure.suptitle(_TIMES_NOTE, x=0.01, ha="left", **TEXT)
    return figure


def scores_figure(data: Results) -> Figure:
    """Return the interquartile mean of each method's normalised score with its interval."""
    methods = data["methods"]
    figure = Figure(figsize=(WIDTH, 0.55 * len(methods) + 1.5), layout="constrained")
    axes = figure.subplots()
    for row, method in enumerate(methods.values()):
        value, low, high = method["normalised"]
        colour = OTHER_COLOURS[row % len(OTHER_COLOURS)]
        axes.plot([low, high], [row, row], color=colour, linewidth=4, alpha=0.5, solid_capstyle="butt")
        beyond = value < LEAST_SCORE
        mark = "<" if beyond else MARKS[row % len(MARKS)]
        axes.plot(max(value, LEAST_SCORE), row, mark, color=colour, markersize=9 if beyond else 7, clip_on=False)
        lost = sum(run["diverged"] for run in method["runs"])
        text = f"{value:.2f} ({low:.2f}..{high:.2f})" + (f"\n{lost} of {len(method['runs'])} diverged" if lost else "")
        axes.text(1.02, row, text, transform=axes.get_yaxis_transform(), va="center", **TEXT)
    for end in (0.0, 1.0):
        axes.axvline(end, color="0.4", linestyle=(0, (2, 2)), linewidth=1.0)
    axes.set_yticks(range(len(methods)), list(methods))
    axes.tick_params(axis="y", length=0, pad=10)
    axes.set(ylim=(len(methods) - 0.4, -0.6), xlabel="normalised score: 0 is random, 1 the best heuristic")
    axes.set_xlim(left=max(axes.get_xlim()[0], LEAST_SCORE))
    axes.grid(True, axis="x", color="0.9")
    axes.spines[["top", "right", "left"]].set_visible(False)
    note = f"Mark and bar: {_interval_note(data)}"
    if any(method["normalised"][0] < LEAST_SCORE for method in methods.values()):
        note += "\nA triangle at the left edge: far below it, by the number on the right."
    figure.suptitle(note, x=0.01, ha="left", **TEXT)
    return figure


_PIECES: Final = {
    "separate": "one torch network after another",
    "decide": "all actors stacked, as flown here",
    "simulate": "the simulator's step",
}
_TIMES_NOTE: Final = "Times: all UAVs together, one thread; the median of the seeds' medians."


def _saved(plots: Mapping[str, Figure], folder: Path) -> list[str]:
    for name, figure in plots.items():
        figure.savefig(folder / name, dpi=DPI)
    return list(plots)


def _interval_note(data: Results) -> str:
    """Return what value and interval are."""
    return f"interquartile mean and {LEVEL:.0%} interval over {seeds(data)} and {data['sizes']['farms']} unseen farms."


def _beside(axes: Axes, found: Mapping[int, Numbers], paper: Mapping[int, float]) -> None:
    """Draw our intervals and the paper's numbers over the same numbers.

    Args:
        axes: where.
        found: our value and the ends of its interval, by number of members or UAVs.
        paper: the paper's value; none is drawn where there is none.
    """
    x = sorted(found)
    value, low, high = np.array([found[number] for number in x]).T
    if paper:
        axes.plot(list(paper), list(paper.values()), "x--", color="0.35", label="paper", markersize=6)
    axes.plot(x, value, "o-", color=OTHER_COLOURS[0], label="ours", markersize=5)
    # Bars have a middle of their own: with few seeds a bootstrap's interval need not hold the value itself, and ratios
    # to a negative reward have their ends the other way round.
    axes.errorbar(x, (low + high) / 2, np.abs(high - low) / 2, fmt="none", color=OTHER_COLOURS[0], capsize=3)
    bare(axes)


def _times(axes: Axes, teams: Mapping[int, Results]) -> None:
    x = sorted(teams)
    axes.plot(list(INFERENCE_BY_UAVS), list(INFERENCE_BY_UAVS.values()), "x--", color="0.35", label="paper")
    for index, (piece, label) in enumerate(_PIECES.items()):
        milliseconds = [teams[number][piece] for number in x]
        colour, line = OTHER_COLOURS[index], LINES[index]
        axes.plot(x, milliseconds, marker=MARKS[index], color=colour, linestyle=line, label=label)
    axes.set(yscale="log", xlabel="UAVs, logarithmic", ylabel="ms for each time step, logarithmic")
    _logarithmic(axes, sorted({*INFERENCE_BY_UAVS, *x}))
    bare(axes)


def _below(figure: Figure, axes: Axes) -> None:
    """Put the legend of one of the figure's axes under it."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, **TEXT)


def _logarithmic(axes: Axes, ticks: Sequence[int]) -> None:
    axes.set_xscale("log")
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", which="minor", length=0)
