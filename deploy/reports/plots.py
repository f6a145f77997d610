"""Plots of a run: learning curves, and the UAVs' paths, alone or beside those of another policy.

Colours and marks are those of `rollout/rendering/palette.py`. Nothing here opens a window.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from eia_sec.common.environment import EpisodeMetric
from eia_sec.common.farm import farm_team
from eia_sec.rollout.evaluation import Trajectory
from eia_sec.rollout.rendering.airspace import WindArrow, draw_outlines, outline_handles
from eia_sec.rollout.rendering.farm_map import SOIL
from eia_sec.rollout.rendering.palette import (
    AGE_MAP,
    COLOURS,
    END_MARKERS,
    LABELS,
    SENSOR_MARKERS,
    STYLES,
    TYPES,
    LineStyle,
)
from eia_sec.rollout.sim.conditions.wind import wind_series
from eia_sec.rollout.sim.layout import make_layout

DPI: Final = 150
OTHER_COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINES: Final = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKS: Final = ("o", "s", "^", "D", "v", "P")
"""Of curves and points, so that they are told apart without colours, too; `look` puts them together."""
COMPARISON_DPI: Final = 220
"""Higher than DPI, because maps side by side are small."""
SMALL: Final = 0.7
"""Size of markers and lines on such a map, relative to a single map."""
SMOOTH_SHARE: Final = 0.05
"""Width of the smoothing window as a share of the curve."""
TEXT: Final[dict[str, Any]] = {"fontsize": 9}
SCALE_LABELS: Final = ("AoI of a sensor, end", "VDF of a plot, end")
LENGTH: Final = EpisodeMetric("steps", "steps of an episode", "length of an episode", "steps")
LAST_STEPS: Final = 100
"""Steps of the paths on a map; more would cover it."""

Numbers = NDArray[np.float64]


def curves(
    metrics: Sequence[Mapping[str, Any]],
    path: Path,
    levels: Mapping[str, float] | None = None,
    episode_metrics: Sequence[EpisodeMetric] = (),
    title: str = "",
) -> None:
    """Draw the mean reward, that of each type, and the episode metrics or the length of episodes, by episode.

    Args:
        metrics: the run's records. Records of kind "episodes" are drawn, those of kind "imitation" become ticks, and
            all others are ignored.
        path: the picture, PNG.
        levels: mean reward per agent of other policies by name, drawn as labelled lines.
        episode_metrics: the environment's; those that it wants plotted are drawn below the rewards.
        title: whose curves they are.
    """
    curves_figure(metrics, levels, episode_metrics, title).savefig(path, dpi=DPI)


def curves_figure(
    metrics: Sequence[Mapping[str, Any]],
    levels: Mapping[str, float] | None = None,
    episode_metrics: Sequence[EpisodeMetric] = (),
    title: str = "",
) -> Figure:
    """Return the figure that `curves` saves."""
    records = [record for record in metrics if record.get("kind") == "episodes"]
    events = [int(record["episodes"]) for record in metrics if record.get("kind") == "imitation"]
    episodes = np.array([record["episodes"] for record in records], np.float64)
    kinds = [name for name in (records[0]["reward"] if records else {}) if name != "mean"]
    parted = len(kinds) > 1
    figure = Figure(figsize=(8.0, 8.4 if parted else 6.4), layout="constrained")
    heights = (1.6, 1.6, 1.0) if parted else (2.2, 1.0)
    panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    upper, lower = panels[0], panels[-1]
    figure.suptitle(title, fontsize=10)
    for index, name in enumerate(["mean", *(kinds if parted else [])]):
        values = np.array([record["reward"][name] for record in records], np.float64)
        colour = COLOURS.get(name, OTHER_COLOURS[index % len(OTHER_COLOURS)])
        style: LineStyle = STYLES.get(name, "--")
        axes = upper if name == "mean" else panels[1]
        _curve(axes, episodes, values, colour, LABELS.get(name, name), style, 2.2 if name == "mean" else 1.5)
    _levels(upper, levels or {})
    _events(upper, events)
    for axes in panels[:-1]:
        axes.set_ylabel("reward per agent and episode")
    shown = [metric for metric in episode_metrics if metric.plotted and records and metric.name in records[0]]
    for metric in shown or [LENGTH]:
        values = np.array([record[metric.name] for record in records], np.float64)
        colour, style = COLOURS.get(metric.group, COLOURS["mean"]), STYLES.get(metric.group, STYLES["mean"])
        _curve(lower, episodes, values, colour, metric.label, style)
    lower.set_ylim(bottom=0.0)
    lower.set_xlabel("training episodes")
    lower.set_ylabel(", ".join(dict.fromkeys(metric.unit for metric in shown or [LENGTH])))
    for axes in panels:
        bare(axes)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.02), ncols=5, frameon=False, **TEXT)
    return figure


def look(index: int) -> dict[str, Any]:
    """Return colour, line and mark of one of many series, as `Axes.plot` takes them.

    Past the last colour the first one comes again with another line, and line and mark are no pair that was there.
    """
    turn = index // len(OTHER_COLOURS)
    return {
        "color": OTHER_COLOURS[index % len(OTHER_COLOURS)],
        "linestyle": LINES[(index + turn) % len(LINES)],
        "marker": MARKS[(index + 2 * turn) % len(MARKS)],
    }


def bare(axes: Axes) -> None:
    """Give a panel a faint grid below what is drawn, and two spines."""
    axes.set_axisbelow(True)
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)


def trajectories(trajectory: Trajectory, path: Path, title: str = "") -> None:
    """Draw the farm at an episode's end, and the paths of all UAVs in its last LAST_STEPS steps.

    Args:
        trajectory: a recorded episode.
        path: the picture, PNG.
        title: whose paths they are.
    """
    trajectories_figure(trajectory, title).savefig(path, dpi=DPI)


def trajectories_figure(trajectory: Trajectory, title: str = "") -> Figure:
    """Return the figure that `trajectories` saves."""
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    figure.suptitle(title, fontsize=10)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.0, 0.26), height_ratios=(1.0, 0.04, 0.04))
    axes = figure.add_subplot(grid[:, 0])
    scales = _map(axes, trajectory)
    axes.set_title(_headline(trajectory), loc="left", fontsize=9)
    _key(figure, grid, trajectory, scales)
    return figure


def save_comparison(trajectories: Mapping[str, Trajectory], path: Path) -> None:
    """Draw the same episode under several policies side by side: final state, and the paths of the last steps.

    Args:
        trajectories: recorded episodes of one farm by the policies' names.
        path: the picture; its suffix selects the format, for example PNG or PDF.
    """
    comparison_figure(trajectories).savefig(path, dpi=COMPARISON_DPI)


def comparison_figure(trajectories: Mapping[str, Trajectory]) -> Figure:
    """Return the figure that `save_comparison` saves."""
    flown = list(trajectories.values())
    figure = Figure(figsize=(4.7 * len(flown), 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 2 * len(flown), height_ratios=(1.0, 0.03))
    for column, (name, trajectory) in enumerate(trajectories.items()):
        axes = figure.add_subplot(grid[0, 2 * column : 2 * column + 2])
        scales = _map(axes, trajectory, SMALL)
        # A title of two lines ends before the scale bar, also above a small map.
        axes.set_title(f"{name}, {_headline(trajectory).replace(': ', chr(10), 1)}", loc="left", fontsize=9, pad=12)
    halves = (grid[1, : len(flown)], grid[1, len(flown) :])
    for artist, label, half in zip(scales, SCALE_LABELS, halves, strict=True):
        figure.colorbar(artist, cax=figure.add_subplot(half), orientation="horizontal", label=label)
    figure.legend(
        handles=_legend(flown[0]),
        loc="outside lower center",
        ncols=3,
        frameon=False,
        **TEXT,
    )
    return figure


def _map(axes: Axes, trajectory: Trajectory, size: float = 1.0) -> tuple[PathCollection, AxesImage]:
    """Draw plots, sensors and paths with markers of a given size; return the artists with the AoI and VDF scales."""
    world = trajectory.config.world
    plots = axes.imshow(
        trajectory.final_vdf.T,
        origin="lower",
        extent=(0.0, world.field_x, 0.0, world.field_y),
        cmap=SOIL,
        vmin=0.0,
        vmax=world.vdf_max,
        zorder=0,
    )
    draw_outlines(axes, trajectory.config, make_layout(trajectory.config, trajectory.farm))
    if trajectory.config.wind.some:
        series = wind_series(trajectory.config, trajectory.farm, trajectory.episode)
        WindArrow(axes, max(world.speed_x_max, world.speed_y_max)).update(series.mean(axis=0))
    sensors = _sensors(axes, trajectory, size)
    _paths(axes, trajectory, size)
    margin = 0.025 * max(world.field_x, world.field_y)
    axes.set(xlim=(-margin, world.field_x + margin), ylim=(-margin, world.field_y + margin))
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    _scale_bar(axes, world.field_x, world.field_y + margin)
    return sensors, plots


def _key(figure: Figure, grid: GridSpec, trajectory: Trajectory, scales: tuple[PathCollection, AxesImage]) -> None:
    """Draw the legend and both scales into the grid's last column."""
    key = figure.add_subplot(grid[0, -1])
    key.set_axis_off()
    key.legend(
        handles=_legend(trajectory),
        loc="upper left",
        borderaxespad=0.0,
        frameon=False,
        **TEXT,
    )
    for row, (artist, label) in enumerate(zip(scales, SCALE_LABELS, strict=True)):
        figure.colorbar(artist, cax=figure.add_subplot(grid[1 + row, -1]), orientation="horizontal", label=label)


def _curve(axes: Axes, x: Numbers, y: Numbers, colour: str, label: str, style: LineStyle, width: float = 1.5) -> None:
    """Draw a curve faintly, and its moving mean on top."""
    axes.plot(x, y, color=colour, alpha=0.2, linewidth=0.8)
    marker = "o" if len(x) == 1 else ""
    axes.plot(x, smooth(y), color=colour, label=label, linestyle=style, linewidth=width, marker=marker)


def smooth(values: Numbers) -> Numbers:
    """Return the centred moving mean over SMOOTH_SHARE of the values; the window shrinks at both ends."""
    half = int(len(values) * SMOOTH_SHARE / 2)
    total = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    means: Numbers = (total[high] - total[low]) / (high - low)
    return means


def _levels(axes: Axes, levels: Mapping[str, float]) -> None:
    """Draw each level as a dashed line with its name at the right end; names of close levels are moved apart."""
    if not levels:
        return
    low, high = axes.get_ylim()
    low, high = min(low, *levels.values()), max(high, *levels.values())
    axes.set_ylim(low - 0.02 * (high - low), high + 0.04 * (high - low))
    least, text_y = 0.06 * (high - low), -np.inf
    for name, level in sorted(levels.items(), key=lambda item: item[1]):
        axes.axhline(level, color="0.4", linestyle=(0, (5, 3)), linewidth=1.0, zorder=1)
        text_y = max(level, text_y + least)
        axes.annotate(
            f"{name} {level:.{0 if abs(level) >= 20.0 else 1}f}",
            (1.0, level),
            (1.01, text_y),
            xycoords=axes.get_yaxis_transform(),
            textcoords=axes.get_yaxis_transform(),
            va="center",
            color="0.25",
            **TEXT,
        )


def _events(axes: Axes, events: Sequence[int]) -> None:
    """Mark each imitation event by a tick on the upper edge."""
    if events:
        transform = axes.get_xaxis_transform()
        axes.plot(
            events, np.ones(len(events)), "v", color="#CC79A7", transform=transform, clip_on=False, label="imitation"
        )


def _sensors(axes: Axes, trajectory: Trajectory, size: float) -> PathCollection:
    """Draw the sensors, a marker for each type; return the artist with the colour scale."""
    artist: PathCollection | None = None
    for kind in range(len(trajectory.config.world.sensor_cycles)):
        chosen = trajectory.sensor_type == kind
        artist = axes.scatter(
            trajectory.sensor_xy[chosen, 0],
            trajectory.sensor_xy[chosen, 1],
            c=trajectory.final_aoi[chosen],
            cmap=AGE_MAP,
            vmin=0.0,
            vmax=trajectory.config.world.aoi_max,
            marker=SENSOR_MARKERS[kind % len(SENSOR_MARKERS)],
            s=20 * size**2,
            linewidths=0.4 * size,
            edgecolors="white",
            zorder=2,
        )
    assert artist is not None, "a farm has at least one sensor type"
    return artist


def _paths(axes: Axes, trajectory: Trajectory, size: float) -> None:
    """Draw every UAV's path with start and end, and the final links between relays and the UAVs they serve."""
    ends = trajectory.position[-1]
    relays = trajectory.config.world.communication_uavs
    for served, relay in enumerate(trajectory.assignment):
        if relay >= 0:
            axes.plot(*ends[[relay, relays + served]].T, color="0.15", linewidth=1.0, linestyle=":", zorder=4)
    for name, agents in zip(TYPES, farm_team(trajectory.config).agent_slices(), strict=True):
        for agent in range(agents.start, agents.stop):
            path, colour = trajectory.position[-1 - _drawn(trajectory) :, agent], COLOURS[name]
            axes.plot(*path.T, color=colour, linestyle=STYLES[name], linewidth=1.1 * size, alpha=0.8, zorder=3)
            axes.plot(*path[0], "o", color=colour, markerfacecolor="white", markersize=6 * size, zorder=5)
            axes.plot(
                *path[-1], END_MARKERS[name], color=colour, markeredgecolor="white", markersize=10 * size, zorder=6
            )


def _scale_bar(axes: Axes, field_x: float, top: float) -> None:
    """Draw a scale bar above the map's upper right corner."""
    power = 10.0 ** np.floor(np.log10(field_x / 4))
    length = max(step * power for step in (1, 2, 5) if step * power <= field_x / 4)
    y = top + field_x * 0.015
    axes.plot([field_x - length, field_x], [y, y], color="black", linewidth=2.0, clip_on=False)
    axes.text(field_x - length / 2, y + field_x * 0.008, f"{length:g} m", ha="center", va="bottom", **TEXT)


def _headline(trajectory: Trajectory) -> str:
    summary = trajectory.summary
    return (
        f"farm {trajectory.farm}, {summary.steps} steps: reward {np.mean(summary.reward):.0f} per agent, "
        f"AoI {summary.metrics['aoi']:.2f}, VDF {summary.metrics['vdf']:.2f}"
    )


def _drawn(trajectory: Trajectory) -> int:
    """Return how many steps of the paths a map shows."""
    return min(LAST_STEPS, len(trajectory.position) - 1)


def _legend(trajectory: Trajectory) -> list[Artist]:
    """Return the legend's entries."""
    handles: list[Artist] = [
        Line2D(
            [],
            [],
            color=COLOURS[name],
            linestyle=STYLES[name],
            marker=END_MARKERS[name],
            markeredgecolor="white",
            markersize=9,
            label=f"{LABELS[name]} UAV, end",
        )
        for name in TYPES
    ]
    start = f"UAV {_drawn(trajectory)} steps before"
    handles.append(Line2D([], [], color="0.3", marker="o", markerfacecolor="white", linestyle="", label=start))
    handles.append(Line2D([], [], color="0.15", linestyle=":", label="relay link, end"))
    for kind, cycle in enumerate(trajectory.config.world.sensor_cycles):
        marker = SENSOR_MARKERS[kind % len(SENSOR_MARKERS)]
        handles.append(Line2D([], [], color="0.5", marker=marker, linestyle="", label=f"sensor, every {cycle} s"))
    return [*handles, *outline_handles(trajectory.config)]
