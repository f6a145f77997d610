"""The two pictures of a run: how it learned, and where its UAVs flew.

Colours are Okabe and Ito's, which people with any colour vision tell apart; every difference that a colour makes is
also made by a marker, a line style or a label. Nothing here opens a window.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from common.team import COLLECTION, COMMUNICATION, MONITORING
from rollout.evaluation import Trajectory

DPI: Final = 150
COLOURS: Final = {COMMUNICATION: "#0072B2", MONITORING: "#D55E00", COLLECTION: "#009E73", "mean": "#000000"}
LABELS: Final = {
    "mean": "all agents",
    COMMUNICATION: "communication",
    MONITORING: "monitoring",
    COLLECTION: "data collection",
}
SENSOR_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "*")
SMOOTH_SHARE: Final = 0.05
"""Width of the smoothing window as a share of the curve."""
TEXT: Final = {"fontsize": 9}


def curves(metrics: Sequence[Mapping[str, Any]], path: Path, levels: Mapping[str, float] | None = None) -> None:
    """Draw reward, AoI and VDF against episodes.

    Args:
        metrics: the run's records; those of kind "episodes" are drawn, those of kind "imitation" become ticks, all
            others are left out.
        path: the picture, PNG.
        levels: mean reward per agent of other policies by name, drawn as labelled lines.
    """
    curves_figure(metrics, levels).savefig(path, dpi=DPI)


def curves_figure(metrics: Sequence[Mapping[str, Any]], levels: Mapping[str, float] | None = None) -> Figure:
    """Return the picture that `curves` saves."""
    records = [record for record in metrics if record.get("kind") == "episodes"]
    events = [int(record["episodes"]) for record in metrics if record.get("kind") == "imitation"]
    episodes = np.array([record["episodes"] for record in records], np.float64)
    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    for name in (COMMUNICATION, MONITORING, COLLECTION, "mean"):
        values = np.array([record["reward"][name] for record in records], np.float64)
        _curve(upper, episodes, values, COLOURS[name], LABELS[name], width=2.2 if name == "mean" else 1.5)
    _levels(upper, levels or {})
    _events(upper, events)
    upper.set_ylabel("reward of an episode, per agent")
    for name, colour, style in (("aoi", COLOURS[COLLECTION], "-"), ("vdf", COLOURS[MONITORING], "--")):
        values = np.array([record[name] for record in records], np.float64)
        _curve(lower, episodes, values, colour, f"mean {name.upper().replace('AOI', 'AoI')}", style=style)
    lower.set_ylim(bottom=0.0)
    lower.set_xlabel("training episodes")
    lower.set_ylabel("units (lower is fresher)")
    for axes in (upper, lower):
        axes.grid(True, color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, **TEXT)
    return figure


def trajectories(trajectory: Trajectory, path: Path) -> None:
    """Draw the farm and the paths of all UAVs over it.

    Args:
        trajectory: a recorded episode.
        path: the picture, PNG.
    """
    trajectories_figure(trajectory).savefig(path, dpi=DPI)


def trajectories_figure(trajectory: Trajectory) -> Figure:
    """Return the picture that `trajectories` saves."""
    world = trajectory.config.world
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.subplots()
    plots = axes.imshow(
        trajectory.final_vdf.T,
        origin="lower",
        extent=(0.0, world.field_x, 0.0, world.field_y),
        cmap="Greys",
        vmin=0.0,
        vmax=2.0 * world.vdf_max,
        zorder=0,
    )
    sensors = _sensors(axes, trajectory)
    _paths(axes, trajectory)
    _links(axes, trajectory)
    axes.set(xlim=(0.0, world.field_x), ylim=(0.0, world.field_y), xlabel="x, m", ylabel="y, m", aspect="equal")
    reward = float(np.mean(trajectory.summary.reward))
    axes.set_title(
        f"farm {trajectory.farm}, {len(trajectory.position) - 1} steps: {reward:.0f} reward per agent, "
        f"mean AoI {trajectory.summary.aoi:.2f}, mean VDF {trajectory.summary.vdf:.2f}",
        loc="left",
        fontsize=10,
    )
    _scale_bar(axes, world.field_x, world.field_y)
    figure.colorbar(sensors, ax=axes, location="right", shrink=0.4, anchor=(0.0, 0.0), label="AoI of a sensor, end")
    bar = figure.colorbar(plots, ax=axes, location="right", shrink=0.4, anchor=(0.0, 0.0), label="VDF of a plot, end")
    bar.ax.set_ylim(0.0, world.vdf_max)
    figure.legend(handles=_legend(trajectory), loc="outside right upper", frameon=False, **TEXT)
    return figure
