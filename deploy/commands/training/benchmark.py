"""`eia-sec benchmark`: algorithms over seeds and environments, as a comparison that can be published."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final

import tyro
from rich.console import Console

from eia_sec.common import plugins
from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.files import from_toml
from eia_sec.common.config.presets import preset, preset_for
from eia_sec.common.errors import RunDirError, UsageError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.benchmark.page import DATA, PICTURES, environment_table, page
from eia_sec.deploy.benchmark.plan import Plan
from eia_sec.deploy.benchmark.records import FILE_MODE, JOB, Records
from eia_sec.deploy.benchmark.scores import Scores
from eia_sec.deploy.benchmark.trainings import Measuring, Training
from eia_sec.deploy.exit_codes import DONE, INTERRUPTED
from eia_sec.deploy.local.code_options import code_options, plugin_options
from eia_sec.deploy.local.contained_files import write
from eia_sec.deploy.local.process_queue import ProcessQueue, Work
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.local.supervisor import Supervisor
from eia_sec.deploy.local.threads import allowed_cores
from eia_sec.deploy.options import PRESET_HELP, parse, with_settings
from eia_sec.deploy.output import patient_output
from eia_sec.deploy.reports.provenance import made_by

RECORDS: Final = "records"
LOGS: Final = "logs"
PAGE: Final = "README.md"
LOCK: Final = "benchmark.lock"


@dataclass(frozen=True)
class BenchmarkArguments:
    """Train algorithms on environments over seeds, each run in a process of its own, and compare what they reach.

    What is there already is kept, so the same command goes on after Ctrl-C.
    """

    algorithms: str
    """Names of the algorithms, with commas between: ippo,mappo,eia-ppo."""
    env: str
    """Environments, module:name or farm, with commas between."""
    seeds: int = 5
    """Seeds of each algorithm in each environment, from 0 on."""
    steps: int = 0
    """Environment steps of a run; 0 for those of the preset."""
    out: Path = Path("runs/benchmark")
    """Folder for tables, pictures, marl-eval's data, records and policies."""
    jobs: int | None = None
    """Runs at a time, each with its share of the cores. Default: one for each core."""
    points: int = 10
    """Evaluations along a run."""
    scenarios: int = 32
    """Scenarios of each; at the end there are ten times as many."""
    preset: Annotated[str, tyro.conf.arg(help=PRESET_HELP)] = ""
    config: Path | None = None
    """TOML file whose values override the preset's."""
    set: tuple[str, ...] = ()
    """Single values that override everything else, for example algorithm.hidden=128."""


def command(arguments: Sequence[str]) -> int:
    """Do what is missing, then write the comparison; return 0, or 130 where it was stopped."""
    options = parse(BenchmarkArguments, arguments, "benchmark")
    cores = allowed_cores()
    jobs = cores if options.jobs is None else options.jobs
    within(1, 1024, jobs=jobs)
    plan = plan_of(options)
    plan.require_possible()
    directory, records = _folder(options.out)
    console = Console(file=patient_output(), highlight=False, markup=False, soft_wrap=True)
    missing = [training for training in plan.all if records.get(training) is None]
    there = len(plan.all) - len(missing)
    console.print(f"{len(missing)} runs to do, {there} are there; {jobs} at a time, in {options.out}")
    stop = StopSignal()
    stop.install()
    try:
        logs = directory.path / LOGS
        queue = ProcessQueue(Supervisor(logs), logs, jobs, console.print, max(1, cores // jobs))
        if not queue.run([_Process(training, records) for training in missing], stop):
            console.print("stopped; every finished run is kept, and the same command goes on from there.")
            return INTERRUPTED
    finally:
        stop.uninstall()
        directory.unlock()
    _write(plan, records, options, arguments, console)
    return DONE


def plan_of(options: BenchmarkArguments) -> Plan:
    """Return what is to be trained.

    Raises:
        UsageError: something in the options does not exist or cannot be compared.
    """
    algorithms = _listed("--algorithms", options.algorithms)
    environments = [plugins.environment(name) for name in _listed("--env", options.env)]
    bases = [_base(options, name) for name in environments]
    return Plan.of(bases, algorithms, options.seeds, Measuring(options.points, options.scenarios))


def _base(options: BenchmarkArguments, environment: str) -> RunConfig:
    """Return what runs on an environment begin from: as with `eia-sec train`, before algorithm and seed."""
    config = preset(options.preset or preset_for(environment))
    if options.config is not None:
        config = from_toml(options.config, config)
    config = with_settings(config.with_environment(environment), options.set)
    if plugins.loaded():
        config = replace(config, plugins=plugins.loaded())
    if not options.steps:
        return config
    within(1, 10**12, steps=options.steps)
    return replace(config, steps=options.steps, episodes=0)


def _listed(option: str, text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise UsageError(f"{option} is a list of names with commas between, not {text!r}.")
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise UsageError(f"{option} has {twice[0]} twice.")
    return names


def _folder(path: Path) -> tuple[RunDirectory, Records]:
    """Return the folder, which is this command's alone until it ends, and its records.

    Raises:
        RunDirError: it is in use, holds something else, or cannot be written.
    """
    if path.is_dir() and any(path.iterdir()) and not (path / RECORDS).is_dir():
        raise RunDirError(f"{path} is not the folder of a benchmark; choose another --out.")
    try:
        (path / RECORDS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunDirError(f"cannot write into {path}: {error.strerror}.") from error
    directory = RunDirectory(path)
    directory.lock(LOCK)
    return directory, Records(path / RECORDS)


class _Process(Work):
    """The process that does a training."""

    def __init__(self, training: Training, records: Records) -> None:
        self._training, self._records = training, records
        self._job = records.path(training, JOB)
        words = ["measure", *code_options(training.config), "--job", str(self._job.absolute())]
        super().__init__(training.name, training.label, words, float(training.config.steps))

    def begin(self, stop: StopSignal) -> bool:
        write(self._job.parent, self._job.name, self._training.to_json().encode(), FILE_MODE)
        return not stop

    def is_done(self) -> bool:
        return self._records.get(self._training) is not None

    def clean(self) -> None:
        """Leave the training beside its record: it says with which configuration that was made."""


def _write(
    plan: Plan, records: Records, options: BenchmarkArguments, arguments: Sequence[str], console: Console
) -> None:
    """Write data, pictures and page of a plan whose trainings are all done; raise RunDirError if that cannot be."""
    from eia_sec.deploy.benchmark.figures import save_pictures  # noqa: PLC0415  (loading the plots would delay the runs)

    found = {training.name: records.get(training) for training in plan.all}
    scores = Scores(plan, {name: result for name, result in found.items() if result is not None})
    config = plan.trainings[0].config
    modules = [*plan.environments, *config.plugins]
    made = made_by("eia-sec benchmark", [*plugin_options(config), *arguments], modules)
    try:
        write(options.out, DATA, json.dumps(scores.marl_eval()).encode() + b"\n", FILE_MODE)
        save_pictures(scores, options.out)
        write(options.out, PAGE, page(scores, made, train_options(options)).encode(), FILE_MODE)
    except OSError as error:
        raise RunDirError(f"cannot write into {options.out}: {error.strerror}.") from error
    for environment in plan.environments:
        console.print("\n".join(["", environment, *environment_table(scores, environment)]))
    console.print(f"\nwritten to {options.out}: {PAGE}, {', '.join(PICTURES)}, {DATA}, {RECORDS}/")


def train_options(options: BenchmarkArguments) -> list[str]:
    """Return what `eia-sec train` takes for preset, file and settings."""
    words = ["--preset", options.preset] if options.preset else []
    words += [] if options.config is None else ["--config", str(options.config)]
    for setting in options.set:
        key, _, value = (part.strip() for part in setting.partition("="))
        text = value[1:-1] if value[:1] in ("'", '"') else value  # a setting is TOML, an option plain text
        words.append(f"--{key.replace('_', '-')}={text}")
    return words
