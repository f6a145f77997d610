"""Pictures of the `trajectories` study: paths over the farm and in space, and what was collected as time went by."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from common.team import COLLECTION, COMMUNICATION, MONITORING
from deploy.figures import DPI, TEXT, save_contest
from deploy.studies.bench import Bench
from deploy.studies.flights import agents_by_type, flights
from rollout.evaluation import Trajectory
from rollout.palette import COLOURS, LABELS, STYLES


def save_flights(bench: Bench, folder: Path) -> list[str]:
    """Draw every flight; return the files' names."""
    names = []
    for farm, flown in flights(bench).items():
        save_contest(flown, folder / f"farm-{farm}.png")
        space_figure(flown).savefig(folder / f"farm-{farm}-3d.png", dpi=DPI)
        collected_figure(flown).savefig(folder / f"farm-{farm}-collected.png", dpi=DPI)
        names += [f"farm-{farm}.png", f"farm-{farm}-3d.png", f"farm-{farm}-collected.png"]
    return names


def space_figure(flown: dict[str, Trajectory]) -> Figure:
    """Return the paths in three dimensions: each type in its plane."""
    figure = Figure(figsize=(6.0 * len(flown), 5.6), layout="constrained")
    for place, (name, trajectory) in enumerate(flown.items()):
        axes: Any = figure.add_subplot(1, len(flown), place + 1, projection="3d")
        world = trajectory.config.world
        heights = {
            COMMUNICATION: world.height_communication,
            MONITORING: world.height_monitoring,
            COLLECTION: world.height_collection,
        }
        for kind, agents in agents_by_type(trajectory).items():
            for agent in range(agents.start, agents.stop):
                x, y = trajectory.position[:, agent].T
                label = f"{LABELS[kind]}, {heights[kind]:g} m" if agent == agents.start else None
                z = np.full(len(x), heights[kind])
                axes.plot(x, y, z, color=COLOURS[kind], linestyle=STYLES[kind], linewidth=0.9, alpha=0.8, label=label)
                axes.plot(x[-1:], y[-1:], z[-1:], "o", color=COLOURS[kind], markersize=5)
        axes.set(
            xlim=(0.0, world.field_x),
            ylim=(0.0, world.field_y),
            xlabel="x, m",
            ylabel="y, m",
            zlabel="height, m",
            zlim=(min(heights.values()) - 1, max(heights.values()) + 1),
        )
        axes.set_title(f"{name}: reward {np.mean(trajectory.summary.reward):.0f} per agent", fontsize=10)
        axes.view_init(elev=24, azim=-62)
        axes.legend(frameon=False, loc="upper left", **TEXT)
    return figure


def collected_figure(flown: dict[str, Trajectory]) -> Figure:
    """Return the units that each monitoring and data collection UAV has collected against the steps."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, kind in zip(figure.subplots(1, 2), (MONITORING, COLLECTION), strict=True):
        for place, (name, trajectory) in enumerate(flown.items()):
            agents = agents_by_type(trajectory)[kind]
            for agent in range(agents.start, agents.stop):
                axes.plot(
                    trajectory.collected[:, agent],
                    color=COLOURS[kind] if place == 0 else "0.45",
                    linestyle="-" if place == 0 else "--",
                    linewidth=1.2,
                    label=name if agent == agents.start else None,
                )
        axes.set(xlabel="step", ylabel="units so far, each UAV")
        axes.set_title(LABELS[kind], fontsize=10)
        axes.grid(True, color="0.9")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, **TEXT)
    return figure
