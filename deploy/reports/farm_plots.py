"""A plot of a farm."""

from pathlib import Path
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.errors import UsageError
from eia_sec.deploy.reports.plots import DPI, TEXT
from eia_sec.rollout.rendering.airspace import draw_outlines
from eia_sec.rollout.rendering.palette import SENSOR_MARKERS
from eia_sec.rollout.sim.layout import GIVEN, Layout, make_layout

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
    draw_sensors(axes, layout, world, 16.0)
    axes.set(xlabel="x, m", ylabel="y, m")
    what = "given places" if layout.density == GIVEN else layout.density
    axes.set_title(f"{what}, farm {seed}: {world.sensors} sensors", loc="left", fontsize=10)
    figure.legend(loc="outside right upper", frameon=False, **TEXT)
    save_picture(figure, path)


def save_picture(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; raise UsageError where it cannot be written."""
    try:
        figure.savefig(path, dpi=DPI, format="png", bbox_inches="tight")
    except OSError as error:
        raise UsageError(f"the picture {path} cannot be written: {error.strerror}.") from error


def draw_sensors(axes: Axes, layout: Layout, world: WorldConfig, size: float) -> None:
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
