"""Pictures of the `trajectories` study: paths over the farm and in space, and what was collected as time went by."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING
from eia_sec.deploy.reports.intervals import Numbers
from eia_sec.deploy.reports.plots import DPI, TEXT, save_comparison
from eia_sec.rollout.evaluation import Trajectory
from eia_sec.rollout.rendering.palette import COLOURS, END_MARKERS, LABELS, STYLES
from research.studies.flights import agents_by_type, flown_again
from research.studies.scales import SCALES

BOX: Final = (4.0, 4.0, 3.0)
"""Sides of the box that the paths in space are drawn in."""

UNITS: Final = {MONITORING: "VDF", COLLECTION: "AoI"}
"""What a type collects."""


def save_flights(data: Mapping[str, Any], folder: Path) -> list[str]:
    """Draw every flight that the study's results hold; return the files' names."""
    config, names = SCALES[data["scale"]].base().farm, []
    for farm, held in data["farms"].items():
        flown = {name: flown_again(config, int(farm), flight) for name, flight in held.items()}
        save_comparison(flown, folder / f"farm-{farm}.png")
        space_figure(held, config).savefig(folder / f"farm-{farm}-3d.png", dpi=DPI)
        collected_figure(flown).savefig(folder / f"farm-{farm}-collected.png", dpi=DPI)
        names += [f"farm-{farm}.png", f"farm-{farm}-3d.png", f"farm-{farm}-collected.png"]
    return names


def space_figure(flown: Mapping[str, Mapping[str, Any]], config: FarmConfig) -> Figure:
    """Return the paths in three dimensions: each type in its plane.

    Args:
        flown: by the policy's name its `reward` per agent and its `paths` [T + 1, n, 2], m.
        config: the farm.
    """
    world = config.world
    heights = {
        COMMUNICATION: world.height_communication,
        MONITORING: world.height_monitoring,
        COLLECTION: world.height_collection,
    }
    low, high = min(heights.values()) - 1.0, max(heights.values()) + 1.0
    figure = Figure(figsize=(4.6 * len(flown), 4.6))
    # Automatic layouts leave no room for the name of a third axis.
    figure.subplots_adjust(left=0.0, right=0.96, bottom=0.1, top=0.94, wspace=0.08)
    for place, (name, flight) in enumerate(flown.items()):
        axes: Any = figure.add_subplot(1, len(flown), place + 1, projection="3d")
        for kind, agents in agents_by_type(config).items():
            paths = np.array(flight["paths"], np.float64)[:, agents].swapaxes(0, 1)
            _planes(axes, paths, kind, heights[kind])
        axes.set(xlim=(0.0, world.field_x), ylim=(0.0, world.field_y), zlim=(low, high))
        axes.set(xlabel="x, m", ylabel="y, m", zlabel="height, m")
        axes.set(xticks=np.linspace(0.0, world.field_x, 5), yticks=np.linspace(0.0, world.field_y, 5))
        axes.set_title(f"{name}: reward {flight['reward']:.0f} per agent", fontsize=10, y=0.95)
        axes.set_box_aspect(BOX, zoom=0.98)
        axes.tick_params(labelsize=9)
        axes.view_init(elev=24, azim=-62)
    stretch = (BOX[2] / (high - low)) / (BOX[0] / world.field_x)
    figure.suptitle(
        f"Heights are drawn {stretch:.0f} times as tall as lengths: {high - low:g} m stand beside {world.field_x:g} m. "
        "A mark is the end of a path.",
        x=0.01,
        ha="left",
        **TEXT,
    )
    figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncols=3, frameon=False, **TEXT)
    return figure


def _planes(axes: Any, paths: Numbers, kind: str, height: float) -> None:
    """Draw a type's paths [n, T + 1, 2] at their height, m, each with a mark where it ends."""
    look: dict[str, Any] = {"color": COLOURS[kind], "linestyle": STYLES[kind]}
    for index, path in enumerate(paths):
        x, y, z = path[:, 0], path[:, 1], np.full(len(path), height)
        axes.plot(x, y, z, **look, linewidth=0.7, alpha=0.7)
        label = f"{LABELS[kind]}, {height:g} m" if index == 0 else None
        # The last place again, so that the legend shows line and mark as one.
        axes.plot(
            x[-1:], y[-1:], z[-1:], **look, marker=END_MARKERS[kind], markeredgecolor="white", markersize=9, label=label
        )


def collected_figure(flown: dict[str, Trajectory]) -> Figure:
    """Return the units that each monitoring and data collection UAV has collected against the steps."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, kind in zip(figure.subplots(1, 2), (MONITORING, COLLECTION), strict=True):
        for place, (name, trajectory) in enumerate(flown.items()):
            agents = agents_by_type(trajectory.config)[kind]
            for agent in range(agents.start, agents.stop):
                axes.plot(
                    trajectory.collected[:, agent],
                    color=COLOURS[kind] if place == 0 else "0.45",
                    linestyle="-" if place == 0 else "--",
                    linewidth=1.2,
                    label=name if agent == agents.start else None,
                )
        axes.set(xlabel="step of the episode", ylabel=f"{UNITS[kind]} units collected so far")
        axes.set_title(f"{LABELS[kind]}, one line for each UAV", fontsize=10)
        axes.grid(True, color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, **TEXT)
    return figure
