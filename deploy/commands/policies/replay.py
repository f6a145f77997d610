"""`eia-sec replay`: a policy against another on the same episode, as a film and as pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import tyro
from rich.console import Console
from rich.progress import Progress

from common.config.checks import within
from common.errors import UsageError
from common.farm import require_farm
from deploy.exit_codes import DONE
from deploy.local.run_directory import own_folder
from deploy.options import parse
from deploy.policies.evaluate import EvaluateArguments, configuration_of, policy_name
from deploy.policies.replay import Contest, film, paper_pictures
from deploy.reports.film import find_ffmpeg

FOLDER: Final = "replay"
"""Folder for what is made, in the run's directory or in the present one."""


@dataclass(frozen=True)
class ReplayArguments:
    """Film a policy against another on the same episode, and draw the paths of both."""

    run_dir: tyro.conf.Positional[Path | None] = None
    """A run's directory: its configuration and its newest policy."""
    policy: str | None = None
    """A policy's name or file, as eia-sec evaluate takes them; instead of the run's policy, or of a run directory."""
    against: str = "lawnmower"
    """The other policy: static, random, lawnmower, greedy, tour, hungarian, horizon, trained, or a policy file.
    Both fly the run's farm, so actors must see as the run's do: "trained" goes with runs of the default preset."""
    farm: int = 1000
    """The farm's seed; training uses 0 to 19, results are about 1000 and on."""
    episode: int = 0
    """Number of the episode on it, the same as that of eia-sec evaluate."""
    film: Literal["mp4", "gif", "none"] = "mp4"
    """What to make beside the pictures."""
    rate: float = 25.0
    """Pictures a second."""
    every: int | None = None
    """Steps between two pictures. Default: 1 for mp4, 4 for gif, whose rate is then a quarter, too."""
    out: Path | None = None
    """Folder for the files. Default: replay in the run's directory, or in the present one."""
    config: Path | None = None
    """TOML file whose values replace those of the run or of the default preset."""
    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensors' places."""
    set: tuple[str, ...] = ()
    """Single values, for instance farm.world.steps=100; they come last."""


def command(arguments: Sequence[str]) -> int:
    """Make the film and the pictures and print their names; return 0."""
    options = parse(ReplayArguments, arguments, "replay")
    within(0, 2**63 - 1, farm=options.farm, episode=options.episode)
    every = options.every if options.every is not None else 4 if options.film == "gif" else 1
    within(1, 10_000, every=every)
    if not 0.1 <= options.rate <= 240.0:
        raise UsageError(f"--rate must be 0.1 to 240 pictures a second, not {options.rate:g}.")
    contest = _contest(options)
    base = (options.out or own_folder(options.run_dir or Path(), FOLDER)) / f"farm-{options.farm}"
    console = Console(highlight=False, soft_wrap=True, markup=False)
    if options.film != "none":
        find_ffmpeg()
    pictures = [base.with_suffix(suffix) for suffix in (".png", ".pdf")]
    paper_pictures(contest, pictures)
    for path in pictures:
        console.print(f"written: {path}")
    if options.film != "none":
        slower = every if options.film == "gif" and options.every is None else 1
        path = base.with_suffix(f".{options.film}")
        _film(contest, path, options.rate / slower, every, console)
        console.print(f"written: {path}")
    return DONE


def _contest(options: ReplayArguments) -> Contest:
    """Return who flies where; raise UsageError when something that was named does not exist."""
    if options.run_dir is None and options.policy is None:
        raise UsageError("nothing to replay: give a run's directory or --policy NAME.")
    wanted = EvaluateArguments(
        run_dir=options.run_dir,
        policy=options.policy,
        config=options.config,
        farm_file=options.farm_file,
        set=options.set,
    )
    config, name = configuration_of(wanted), policy_name(wanted)
    farm = require_farm(config, "this run is about {}; only the farm can be replayed.")
    shown = options.run_dir.resolve().name if options.run_dir is not None and options.policy is None else _called(name)
    names = _apart(shown, _called(options.against), name, options.against)
    return Contest(farm, (name, options.against), names, options.farm, options.episode)


def _apart(one: str, other: str, path: str, other_path: str) -> tuple[str, str]:
    """Return names of two policies that differ: by their folders where they are called alike, else by a number."""
    if one == other:
        one, other = (f"{Path(place).resolve().parent.name}/{one}" for place in (path, other_path))
    return (one, other) if one != other else (f"{one} (1)", f"{other} (2)")


def _called(name: str) -> str:
    """Return what a policy is called in a picture."""
    if name == "trained":
        return "EIA-SEC (shipped policy)"
    return Path(name).stem if Path(name).suffix else name


def _film(contest: Contest, path: Path, rate: float, every: int, console: Console) -> None:
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(f"filming farm {contest.farm}", total=contest.config.world.steps)
        film(contest, path, rate, every, lambda step: progress.update(task, completed=step))
