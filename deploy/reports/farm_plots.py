"""Plots of farms: a single one, and every density side by side."""

from dataclasses import replace
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.config.farm.world import Density
from eia_sec.common.errors import UsageError
from eia_sec.deploy.reports.plots import DPI, TEXT
from eia_sec.rollout.rendering.airspace import draw_outlines
from eia_sec.rollout.rendering.palette import SENSOR_MARKERS
from eia_sec.rollout.sim.layout import GIVEN, Layout, make_layout

DENSITIES: Final[tuple[Density, ...]] = ("uniform", "irregular", "clustered", "banded", "patchy")
"""All densities, in the order of the plot."""
SEEDS: Final = (0, 1, 2)
"""Farm seeds of each density in the plot."""
TYPE_GREYS: Final = ("0.1", "0.45", "0.65")
"""Of the types of sensors, whose markers differ as well; colours belong to UAVs and ages."""


def draw_farm(config: FarmConfig, seed: int, path: Path) -> None:
    """Draw one farm: its sensors by type, and its plots.

    Args:
        config: the farm.
        seed: its seed.
        path: the picture, PNG.

    Raises:
        UsageError: the picture cannot be written.
    """
    layout, world = make_layout(config, seed), config.world
    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    axes = figure.subplots()
    for x in range(1, world.plots_x):
        axes.axvline(x * world.field_x / world.plots_x, color="0.92", linewidth=0.6, zorder=0)
    for y in range(1, world.plots_y):
        axes.axhline(y * world.field_y / world.plots_y, color="0.92", linewidth=0.6, zorder=0)
    draw_outlines(axes, config, layout)
    _scatter(axes, layout, world, 16.0)
    axes.set(xlabel="x, m", ylabel="y, m")
    what = "given places" if layout.density == GIVEN else layout.density
    axes.set_title(f"{what}, farm {seed}: {world.sensors} sensors", loc="left", fontsize=10)
    figure.legend(loc="outside right upper", frameon=False, **TEXT)
    _save(figure, path)


def draw_densities(path: Path) -> None:
    """Draw every density, a column each, with the farms SEEDS of the default world.

    Args:
        path: the picture, PNG.
    """
    figure = Figure(figsize=(12.0, 7.6), layout="constrained")
    rows = figure.subplots(len(SEEDS), len(DENSITIES), sharex=True, sharey=True)
    for row, seed in zip(rows, SEEDS, strict=True):
        for axes, density in zip(row, DENSITIES, strict=True):
            config = FarmConfig(world=replace(WorldConfig(), density=density))
            _scatter(axes, make_layout(config, seed), config.world, 6.0)
            axes.tick_params(labelsize=7)
            axes.set_title(f"{density}, farm {seed}", loc="left", **TEXT)
        row[0].set_ylabel("y, m", **TEXT)
    for axes in rows[-1]:
        axes.set_xlabel("x, m", **TEXT)
    handles, labels = rows[0][0].get_legend_handles_labels()
    named = [f"sensor, {label}" for label in labels]
    figure.legend(handles, named, loc="outside lower center", ncols=len(named), markerscale=2.0, frameon=False, **TEXT)
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    try:
        figure.savefig(path, dpi=DPI, format="png", bbox_inches="tight")
    except OSError as error:
        raise UsageError(f"the picture {path} cannot be written: {error.strerror}.") from error


def _scatter(axes: Axes, layout: Layout, world: WorldConfig, size: float) -> None:
    """Draw the sensors within the field, with a grey and a marker for each type."""
    for kind, cycle in enumerate(world.sensor_cycles):
        chosen = layout.sensor_type == kind
        axes.scatter(
            layout.sensor_xy[chosen, 0],
            layout.sensor_xy[chosen, 1],
            s=size,
            color=TYPE_GREYS[kind % len(TYPE_GREYS)],
            marker=SENSOR_MARKERS[kind % len(SENSOR_MARKERS)],
            linewidths=0.0,
            clip_on=False,
            label=f"every {cycle} s",
            zorder=2,
        )
    axes.set(xlim=(0.0, world.field_x), ylim=(0.0, world.field_y), aspect="equal")
