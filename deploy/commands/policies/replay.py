"""`eia-sec replay`: two policies on the same episode, as a film and as plots of their paths."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import tyro
from rich.console import Console

from eia_sec.common.config.checks import within
from eia_sec.common.errors import UsageError
from eia_sec.common.farm import require_farm
from eia_sec.deploy.commands.policies.evaluate import EvaluateArguments, configuration_of, policy_name
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.local.run_directory import own_folder
from eia_sec.deploy.options import parse
from eia_sec.deploy.policies.replay import Comparison, film, paper_pictures
from eia_sec.deploy.progress import progress
from eia_sec.deploy.reports.film import find_ffmpeg
from eia_sec.rollout.shipped_policies import SHIPPED

ONLY_FARM: Final = "this run is about {}; only the farm can be replayed."

FOLDER: Final = "replay"
"""Output folder in the run directory or the current directory."""


COST: Final = "about a minute of processor time"
"""What a film of a whole episode of the default farm takes, a frame for each step."""


@dataclass(frozen=True)
class ReplayArguments:
    """Film two policies on the same episode and draw the paths of both."""

    run_dir: tyro.conf.Positional[Path | None] = None
    """Run directory: its configuration and its newest policy."""
    policy: str | None = None
    """Policy name or file, as in eia-sec evaluate; replaces the run's policy."""
    against: str = "lawnmower"
    """The other policy: any name of eia-sec evaluate, or a policy file. Both fly one farm, so a policy must match its
    observations: "trained" fits the preset inertial."""
    farm: int = 1000
    """Farm seed; training uses 0 to 19, evaluation 1000 and above."""
    episode: int = 0
    """Number of the episode on that farm, as in eia-sec evaluate."""
    film: Literal["mp4", "gif", "none"] = "mp4"
    """Format of the film, or none."""
    rate: float = 25.0
    """Frames per second."""
    every: int | None = None
    """Environment steps per frame. Default: 1 for mp4; 4 for gif, at a quarter of the rate."""
    out: Path | None = None
    """Output folder. Default: replay/ in the run directory or the current directory."""
    config: Path | None = None
    """TOML file whose values override those of the run or the preset inertial."""
    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensor positions."""
    set: tuple[str, ...] = ()
    """Single values that override everything else, for example farm.world.steps=100."""


def command(arguments: Sequence[str]) -> int:
    """Write the film and the plots and print their names; return 0."""
    options = parse(ReplayArguments, arguments, "replay")
    within(0, 2**63 - 1, farm=options.farm, episode=options.episode)
    every = options.every if options.every is not None else 4 if options.film == "gif" else 1
    within(1, 10_000, every=every)
    if not 0.1 <= options.rate <= 240.0:
        raise UsageError(f"--rate must be 0.1 to 240 frames per second, not {options.rate:g}.")
    comparison = _comparison(options)
    base = (options.out or own_folder(options.run_dir or Path(), FOLDER)) / f"farm-{options.farm}"
    console = Console(highlight=False, soft_wrap=True, markup=False)
    if options.film != "none":
        find_ffmpeg()
    pictures = [base.with_suffix(suffix) for suffix in (".png", ".pdf")]
    with progress("flying both policies") as tell:
        paper_pictures(comparison, pictures, tell)
    for path in pictures:
        console.print(f"written: {path}")
    if options.film != "none":
        slower = every if options.film == "gif" and options.every is None else 1
        path = base.with_suffix(f".{options.film}")
        console.print(f"filming farm {comparison.farm}: {COST}; --film none leaves it out")
        with progress("filming") as tell:
            film(comparison, path, options.rate / slower, every, tell)
        console.print(f"written: {path}")
    return DONE


def _comparison(options: ReplayArguments) -> Comparison:
    """Return the policies and the episode; raise UsageError if a named thing does not exist."""
    if options.run_dir is None and options.policy is None:
        raise UsageError("nothing to replay: give a run directory or --policy NAME.")
    wanted = EvaluateArguments(
        run_dir=options.run_dir,
        policy=options.policy,
        config=options.config,
        farm_file=options.farm_file,
        set=options.set,
    )
    config, name = configuration_of(wanted, ONLY_FARM), policy_name(wanted)
    farm = require_farm(config, ONLY_FARM)
    shown = options.run_dir.resolve().name if options.run_dir is not None and options.policy is None else _called(name)
    names = _apart(shown, _called(options.against), name, options.against)
    return Comparison(farm, (name, options.against), names, options.farm, options.episode)


def _apart(one: str, other: str, path: str, other_path: str) -> tuple[str, str]:
    """Return distinct names for two policies: equal names get their folder as a prefix or a number as a suffix."""
    if one == other:
        one, other = (f"{Path(place).resolve().parent.name}/{one}" for place in (path, other_path))
    return (one, other) if one != other else (f"{one} (1)", f"{other} (2)")


def _called(name: str) -> str:
    """Return a policy's name for a plot."""
    if name in SHIPPED:
        return "shipped policy" if name == "trained" else f"shipped policy, {SHIPPED[name][0]}"
    return Path(name).stem if Path(name).suffix else name
