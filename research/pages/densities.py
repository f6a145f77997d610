"""The picture of docs/how-to/farms.md: every density side by side."""

from dataclasses import replace
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.config.farm.world import Density
from eia_sec.deploy.reports.farm_plots import draw_sensors, save_picture
from eia_sec.deploy.reports.plots import TEXT
from eia_sec.rollout.sim.layout import make_layout

DENSITIES: Final[tuple[Density, ...]] = ("uniform", "irregular", "clustered", "banded", "patchy")
"""All densities, in the order of the plot."""
SEEDS: Final = (0, 1, 2)
"""Farm seeds of each density in the plot."""


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
            draw_sensors(axes, make_layout(config, seed), config.world, 6.0)
            axes.tick_params(labelsize=7)
            axes.set_title(f"{density}, farm {seed}", loc="left", **TEXT)
        row[0].set_ylabel("y, m", **TEXT)
    for axes in rows[-1]:
        axes.set_xlabel("x, m", **TEXT)
    handles, labels = rows[0][0].get_legend_handles_labels()
    named = [f"sensor, {label}" for label in labels]
    figure.legend(handles, named, loc="outside lower center", ncols=len(named), markerscale=2.0, frameon=False, **TEXT)
    save_picture(figure, path)
