"""`eia-sec farm`: draw, save and check farms."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from scipy.spatial import cKDTree

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.farm.world import Density
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import UsageError
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.options import parse, with_farm_file, with_settings
from eia_sec.deploy.reports.farm_plots import draw_farm
from eia_sec.rollout.farm_files import read_farm, write_farm


@dataclass(frozen=True)
class Source:
    """Options that choose a farm."""

    farm: int = 0
    """Farm seed, as in eia-sec evaluate; training uses 0 to 19."""
    density: Density | None = None
    """Distribution of the sensors. Default: the configuration's."""
    config: Path | None = None
    """TOML file whose values override the preset inertial's, for example a run's config.toml."""
    set: tuple[str, ...] = ()
    """Single values that override everything else, for example farm.world.sensors=100."""


@dataclass(frozen=True)
class ShowArguments(Source):
    """Draw a farm."""

    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensor positions."""
    out: Path = Path("farm.png")
    """Output file, PNG."""


@dataclass(frozen=True)
class SaveArguments(Source):
    """Write a farm as CSV or GeoJSON."""

    out: Path = Path("farm.csv")
    """Output file; the suffix selects the format: .csv, or .geojson or .json."""
    longitude: float | None = None
    """Longitude of the field's south-west corner, degrees; GeoJSON only. Default: 0."""
    latitude: float | None = None
    """Latitude of the field's south-west corner, degrees; GeoJSON only. Default: 0."""


@dataclass(frozen=True)
class CheckArguments:
    """Read a farm file and describe it."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """CSV or GeoJSON file."""


@dataclass(frozen=True)
class FarmArguments:
    """Draw, save or check farms."""

    task: Annotated[
        Annotated[ShowArguments, tyro.conf.subcommand("show")]
        | Annotated[SaveArguments, tyro.conf.subcommand("save")]
        | Annotated[CheckArguments, tyro.conf.subcommand("check")],
        tyro.conf.arg(name=""),
    ]


def command(arguments: Sequence[str]) -> int:
    """Draw, save or check; return 0."""
    task = parse(FarmArguments, arguments, "farm").task
    console = Console(highlight=False, soft_wrap=True, markup=False)
    if isinstance(task, ShowArguments):
        draw_farm(_farm(task, task.farm_file), task.farm, task.out)
        console.print(f"written: {task.out}")
    elif isinstance(task, SaveArguments):
        write_farm(task.out, _farm(task, None), task.farm, _corner(task))
        console.print(f"written: {task.out}")
    else:
        _check(task.file, console)
    return DONE


def _farm(source: Source, farm_file: Path | None) -> FarmConfig:
    """Return the farm that the options choose; raise UsageError for a density that would have no effect."""
    within(0, 2**63 - 1, farm=source.farm)
    config = PRESETS["inertial"] if source.config is None else from_toml(source.config, PRESETS["inertial"])
    if farm_file is not None:
        config = with_farm_file(config, farm_file)
    config = with_settings(config, source.set)
    if source.density is None:
        return config.farm
    if config.farm.world.sites:
        raise UsageError("--density has no effect on a farm whose sensors have given places.")
    return replace(config.farm, world=replace(config.farm.world, density=source.density))


def _corner(task: SaveArguments) -> tuple[float, float]:
    """Return longitude and latitude of the field's corner, degrees."""
    for name, degrees in (("--longitude", task.longitude), ("--latitude", task.latitude)):
        if degrees is not None and task.out.suffix.lower() == ".csv":
            raise UsageError(f"{name} has no effect on {task.out}; a file that ends in .geojson holds degrees.")
    return task.longitude or 0.0, task.latitude or 0.0


def _check(path: Path, console: Console) -> None:
    """Print a description of a farm file."""
    given = read_farm(path)
    marks = given.survey.marks
    console.print(f"{path}: {len(given.xy)} sensors on {given.field_x:g} m x {given.field_y:g} m")
    if len(given.xy) > 1:
        near = cKDTree(np.array(given.xy)).query(given.xy, k=2)[0][:, 1]
        console.print(f"nearest neighbours: {near.min():.3g} m to {near.max():.3g} m, median {np.median(near):.3g} m")
    if marks:
        unit = " s" if given.survey.mark == "cycle" else ""
        counts = ", ".join(f"{marks.count(mark)} of {mark}{unit}" for mark in sorted(set(marks)))
        console.print(f"{given.survey.mark}s: {counts}")
    else:
        console.print("sensor types: drawn from the farm's seed")
