"""`eia-sec train`: all processes of a run on this machine, with a live view and a report at the end."""

import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.live import Live

from eia_sec.common import plugins
from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.config.presets import preset_for
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.common.process import StopSignal
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.credentials import load
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint, free_endpoint
from eia_sec.deploy.commands.training.population import PopulationTraining, best_member
from eia_sec.deploy.local.code_options import code_options, plugin_options
from eia_sec.deploy.local.environment_trial import tried
from eia_sec.deploy.local.learners import refuse_torchrun, require_learners
from eia_sec.deploy.local.members import FOLDER, Members, member_directories, member_name, require_population
from eia_sec.deploy.local.run_directory import TRAIN_LOCK, RunDirectory, new_folder
from eia_sec.deploy.local.served_environments import tried_spec
from eia_sec.deploy.local.threads import allowed_cores
from eia_sec.deploy.local.training_processes import COORDINATOR, LEARNER, ProcessPlan, TrainingProcesses
from eia_sec.deploy.monitor.live_view import render, summary
from eia_sec.deploy.monitor.new_alarms import NewAlarms
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from eia_sec.deploy.monitor.tracker import Tracker, TrackerName, client_of
from eia_sec.deploy.options import PRESET_HELP, base_configuration, parse
from eia_sec.deploy.output import patient_output
from eia_sec.deploy.program import program
from eia_sec.rollout.envs.registry import environment_spec, spec_of_team
from eia_sec.rollout.start_policy import StartParameters, start_parameters, start_sentence

if TYPE_CHECKING:
    from eia_sec.deploy.local.cloning import Clones

REFRESH_SECONDS = 0.5
PLAIN_SECONDS = 10.0
"""Seconds between two lines of output without a terminal."""
READERS = {"monitor": "", "watch": "   # in the browser"}
"""The commands that show a run, and a remark on each."""
RUN = "train"
OPERATOR = "operator.train"
"""Certificate of this process that `--tls` needs besides those of the others."""


@dataclass(frozen=True)
class TrainArguments:
    """Train on this machine: learner, elite coordinator and workers run as separate processes over loopback."""

    preset: Annotated[str, tyro.conf.arg(help=PRESET_HELP)] = ""
    config: Path | None = None
    """TOML file whose values override the preset's."""
    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensor positions; they become part of the run's configuration."""
    workers: int | None = None
    """Number of rollout workers. Default: one, or two where UAVs see plans and there are cores for them (and,
    with --tls, a certificate)."""
    learners: int = 1
    """Learner processes that make the updates together, each with a share of every minibatch (on policy)."""
    run_dir: Path | None = None
    """Run directory. Default: runs/PRESET-TIME."""
    resume: bool = False
    """Resume from the newest intact checkpoint in the run directory."""
    lockstep: bool = False
    """Alternate strictly with one worker: the weights are bit-equal to training in a single process."""
    demonstrations: Path | None = None
    """File of eia-sec record: actors first learn to do what it holds, and value functions what that is worth."""
    endpoint: str | None = None
    """Endpoint of the learner: a loopback address, or with --tls any of this machine. Default: free ports, and
    tcp/127.0.0.1:7447 for environments that others serve."""
    tls: Path | None = None
    """Folder of `eia-sec keys` with a certificate for each process; turns TLS on."""
    shared_memory: bool = False
    """Send transitions through shared memory instead of TCP."""
    track: TrackerName | None = None
    """Also send metrics and configuration to Weights & Biases or MLflow, as their own environment variables say."""
    report: bool = True
    """Evaluate against the heuristics and draw plots at the end."""
    settings: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def command(arguments: Sequence[str]) -> int:
    """Train; return 0 when the run finished or the user stopped it, 1 when it failed."""
    options = parse(TrainArguments, arguments, "train", TrainArguments(settings=base_configuration(arguments)))
    _require_possible(options)
    workers = worker_count(options)
    require_learners(options.settings, options.learners, lockstep=options.lockstep)
    client = None if options.track is None else client_of(options.track)
    endpoint = _endpoint(options, workers)
    endpoint.require_private(insecure=False, advice="choose a loopback address, such as tcp/127.0.0.1:7447")
    # What cannot be trained, or cannot be begun with, is refused before anything is made.
    environment = _environment(options, endpoint)
    team = environment.team
    clones = _clones(options, team)
    start = _start(options, team)
    _require_device(options.settings.learner.device)
    _require_plugins(options.settings)
    stamp = time.strftime("%Y%m%d-%H%M%S")
    chosen = options.preset or preset_for(options.settings.env.name)
    directory = RunDirectory(options.run_dir or new_folder(Path("runs"), f"{chosen}-{stamp}"))
    if clones is not None:
        options = replace(options, settings=clones.settings(directory.path))
    directory.prepare(options.settings, resume=options.resume)
    directory.lock(TRAIN_LOCK)
    directory.adopt(options.settings, team)
    console = Console(file=patient_output())
    begun = start_sentence(options.settings, team, start) if start else ""
    if clones is not None:
        begun = clones.save(directory.path)
    preset = "" if options.preset or options.resume else f"preset: {chosen}; another one: --preset NAME"
    lines = filter(None, (preset, begun, shortage(options.settings, environment)))

    def tell(line: str) -> None:
        console.print(line, highlight=False, markup=False, soft_wrap=True)

    for line in (*lines, *_where_to_watch(options, directory.path)):
        tell(line)
    plan = ProcessPlan(
        options.settings,
        workers,
        directory,
        endpoint,
        RUN,
        lockstep=options.lockstep,
        resume=options.resume,
        shared_memory=options.shared_memory,
        tls=options.tls,
        learners=options.learners,
    )
    asked = command_line(arguments, options, workers)
    if options.settings.population.members:
        _train_population(plan, options, team, console, asked)
    elif client is None:
        _train(plan, options, console, asked)
    else:
        with Tracker(client, directory.path, options.settings, team, tell) as tracker:
            _train(plan, options, console, asked, tracker)
    return 0


def _train(
    plan: ProcessPlan, options: TrainArguments, console: Console, asked: Sequence[str], tracker: Tracker | None = None
) -> None:
    """Train, then report on a run that has finished and say what to type next.

    Args:
        plan: the processes.
        options: what the user gave.
        console: shows the run.
        asked: the command line, for the report.
        tracker: gets metrics, the report's too, and whether the run has finished.
    """
    directory, served = plan.directory, options.settings.env.served
    training = _Training(plan, console, tracker)
    training.run()
    finished = directory.finished()
    if tracker is not None and finished:
        tracker.outcome = "finished"
    if not finished:
        if training.stopped:
            console.print(f"a callback stopped the run: {training.stopped}", highlight=False, markup=False)
        again = resume_command(options, directory.path)
        console.print(f"stopped; resume with: {again}", highlight=False, soft_wrap=True)
    elif options.report and not served:  # a robot moves only as long as it was asked to
        from eia_sec.deploy.reports.run_report import write_report  # noqa: PLC0415  (loading the plots would delay the processes)

        found = write_report(directory, options.settings, asked, console)
        if tracker is not None:
            tracker.log_scalars(found)
    else:
        again = shlex.join([program(), "evaluate", "--run-dir", str(directory.path), *code_options(options.settings)])
        own = "" if options.tls is None else f" --tls {options.tls / LEARNER}"
        where = f" --endpoint {plan.endpoint}{own}" if served else ""
        console.print(f"finished; evaluate with: {again}{where}", highlight=False, soft_wrap=True)


def _train_population(
    plan: ProcessPlan, options: TrainArguments, team: TeamSpec, console: Console, asked: Sequence[str]
) -> None:
    """Train a population; once all members have finished or failed, score the former and report on the best.

    Args:
        plan: the processes of one member, in the run directory.
        options: what the user gave.
        team: the layout of the team.
        console: shows the run.
        asked: the command line, for the report.

    Raises:
        EiaSecError: members have failed; a UsageError where that are all, for the same mistake.
    """
    root, config = plan.directory, options.settings
    members = Members(root, plan, team)
    PopulationTraining(members, console).run()
    failed = {member.name for member in members.training if member.failure is not None}
    directories = member_directories(root.path, config)
    unfinished = {directory.path.name for directory in directories if not directory.finished()}
    if unfinished - failed:
        console.print(f"stopped; resume with: {resume_command(options, root.path)}", highlight=False, soft_wrap=True)
    elif len(unfinished) < len(directories):
        best = best_member(root, config, team, console)
        if options.report:
            from eia_sec.deploy.reports.run_report import write_report  # noqa: PLC0415  (loading the plots would delay the processes)

            write_report(best, best.configuration(), asked, console)
    if (failure := members.failure()) is not None:
        raise failure


def _where_to_watch(options: TrainArguments, run: Path) -> list[str]:
    """Return lines with the run directory and the commands that show the run."""
    watched, shown = "it", run
    if options.settings.population.members:
        watched, shown = "a member", run / FOLDER / member_name(0)
    lines = [f"run directory: {run}; to watch {watched} from another terminal:"]
    for reader, where in READERS.items():
        own = "" if options.tls is None else f" --tls {options.tls / f'{reader}.NAME'}"
        lines.append(f"  {shlex.quote(program())} {reader} {shlex.quote(str(shown))}{own}{where}")
    return lines


def _require_possible(options: TrainArguments) -> None:
    """Raise ConfigError or UsageError for options that exclude each other, or several processes of torchrun."""
    refuse_torchrun("train")
    if options.lockstep and options.resume:
        raise ConfigError("a lockstep run cannot be resumed: its worker would restart with its first episode.")
    if options.resume and options.run_dir is None:
        raise UsageError("--resume needs --run-dir.")
    if options.settings.population.members:
        _require_population(options)


def _require_population(options: TrainArguments) -> None:
    """Raise ConfigError or UsageError for options that a population does not have."""
    alone = {
        "--lockstep": options.lockstep,
        "--learners": options.learners > 1,
        "--demonstrations": options.demonstrations is not None,
        "--track": options.track is not None,
        "--endpoint": options.endpoint is not None,
    }
    if named := [name for name, given in alone.items() if given]:
        raise UsageError(f"{named[0]} is for a run alone; leave it or --population out.")
    require_population(options.settings)


def _start(options: TrainArguments, team: TeamSpec) -> StartParameters:
    """Return what a run's actors begin as, after a check of options that name types; nothing for one that resumes."""
    if options.resume:
        return ()
    options.settings.algorithm.require_types(team.types)
    return start_parameters(options.settings, team)


def _clones(options: TrainArguments, team: TeamSpec) -> "Clones | None":
    """Return the actors that demonstrations give, or None without any."""
    if options.demonstrations is None:
        return None
    from eia_sec.deploy.local.cloning import Clones  # noqa: PLC0415  (importing torch takes seconds, and only this needs it)

    return Clones(options.settings, team, options.demonstrations, resume=options.resume)


def shortage(config: RunConfig, environment: EnvironmentSpec) -> str:
    """Return a sentence about a run that ends before its first update, or an empty string."""
    limits = (config.episodes * environment.episode_steps[1], config.steps)
    most = min(limit for limit in limits if limit)
    if config.learns_on_policy:
        needed, option = config.on_policy.iteration_steps, "algorithm.iteration_steps"
    else:
        needed, option = max(config.off_policy.batch, config.replay.warmup_steps + 1), "replay.warmup_steps"
    if most >= needed:
        return ""
    return (
        f"this run will learn nothing: it has at most {most:,} steps, and the first update needs {needed:,}; raise "
        f"{'episodes' if config.episodes else 'steps'} or lower {option}."
    )


def command_line(arguments: Sequence[str], options: TrainArguments, workers: int) -> list[str]:
    """Return the command that made a run, with the number of workers where it was left to the machine.

    Args:
        arguments: the command line, from which `--plugin` was taken away.
        options: what it said.
        workers: how many there were.
    """
    counted = ["--workers", str(workers)] if options.workers is None else []
    return ["eia-sec", "train", *plugin_options(options.settings), *arguments, *counted]


def resume_command(options: TrainArguments, run: Path) -> str:
    """Return the command that goes on with a run, with what no configuration holds: workers, keys and environment."""
    more = "" if options.workers is None else f" --workers {options.workers}"
    more += "" if options.learners == 1 else f" --learners {options.learners}"
    more += "" if options.tls is None else f" --tls {options.tls}"
    more += " --shared-memory" if options.shared_memory else ""
    more += "" if options.track is None else f" --track {options.track}"
    named = [shlex.quote(word) for word in code_options(options.settings)]
    return " ".join([f"{shlex.quote(program())} train --run-dir {run} --resume{more}", *named])


def worker_count(options: TrainArguments) -> int:
    """Return the number of rollout workers.

    Raises:
        ConfigError: when it is not 1 to 1,024, or not 1 in lockstep.
    """
    if options.workers is None:
        slow = not options.settings.env.is_third_party and options.settings.farm.observation.plan > 0
        certified = options.tls is None or (options.tls / "rollout.1").is_dir()
        cores = allowed_cores() // options.settings.rollout.threads
        return 2 if slow and certified and cores > 1 and not options.lockstep else 1
    within(1, 1024, workers=options.workers)
    if options.lockstep and options.workers != 1:
        raise ConfigError("--lockstep needs exactly one worker; leave --workers out.")
    return options.workers


def _require_device(name: str) -> None:
    """Raise ConfigError unless the learner's device exists, before any file is written."""
    if name != "cpu":
        from eia_sec.learner.networks.device import usable_device  # noqa: PLC0415  (importing torch takes seconds, and only this needs it)

        usable_device(name)


def _require_plugins(config: RunConfig) -> None:
    """Raise PluginError unless what the run takes from plug-ins can be used, before any file is written."""
    if config.plugins:
        from eia_sec.learner.registry import require_algorithm  # noqa: PLC0415  (likewise)

        require_algorithm(config.algorithm)
        plugins.check_callbacks(config.plugins)


def _endpoint(options: TrainArguments, workers: int) -> Endpoint:
    """Return where the learner listens, with the operator's certificate; raise when a certificate is missing."""
    where = options.endpoint or (DEFAULT if options.settings.env.served else str(free_endpoint()))
    if options.tls is None:
        return Endpoint.parse(where)
    for index in range(workers):
        load(options.tls / f"rollout.{index}")
    for process in (LEARNER, COORDINATOR):
        load(options.tls / process)
    return Endpoint.parse(where, options.tls / OPERATOR)


def _environment(options: TrainArguments, endpoint: Endpoint) -> EnvironmentSpec:
    """Return the run's environment after a trial; a run that resumes knows the team of one that others serve."""
    config = options.settings
    if not config.env.served:
        return tried(config) if config.env.is_third_party else environment_spec(config)
    team = RunDirectory(options.run_dir).team() if options.resume and options.run_dir is not None else None
    if team is not None:
        return spec_of_team(config, team)
    listener = endpoint if options.tls is None else Endpoint.parse(str(endpoint), options.tls / LEARNER)
    return tried_spec(config, listener)


class _Training:
    """The processes and the view of them, and what a tracker is told.

    Attributes:
        stopped: why a callback of a plug-in stopped the run, or empty.
    """

    def __init__(self, plan: ProcessPlan, console: Console, tracker: Tracker | None = None) -> None:
        self._console, self._tracker = console, tracker
        self._stop = StopSignal()
        self._processes = TrainingProcesses(plan)
        self._printed = 0.0
        self.stopped = ""

    def run(self) -> None:
        """Train until the learner is done or the user stops it; no process is left afterwards."""
        self._stop.install()
        processes = self._processes
        try:
            processes.start()
            bus = processes.connect(lambda: bool(self._stop))
            if bus is not None:
                with bus:
                    monitor = RunMonitor(bus, RUN)
                    self._watch(monitor)
                    if self._stop:
                        self._drain(bus)
                    monitor.update()
                    self._track(monitor)
                    self.stopped = monitor.stopped_by()
        finally:
            processes.stop()
            self._stop.uninstall()
        if self._stop:
            for line in processes.undelivered():
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)
        processes.raise_failure()

    def _watch(self, monitor: RunMonitor) -> None:
        processes = self._processes
        if not self._console.is_terminal:
            alarms = NewAlarms()
            while not (self._stop or processes.over):
                self._tick(monitor)
                snapshot = monitor.snapshot(self._track(monitor))
                lines = alarms.of(snapshot)
                if time.monotonic() - self._printed >= PLAIN_SECONDS:
                    self._printed = time.monotonic()
                    lines.append(summary(snapshot))
                for line in lines:
                    self._console.print(line, highlight=False, markup=False, soft_wrap=True)
            return
        with Live(console=self._console, auto_refresh=False, transient=False) as live:
            while not (self._stop or processes.over):
                self._tick(monitor)
                snapshot = monitor.snapshot((*processes.supervisor.alarms, *self._track(monitor)))
                live.update(render(snapshot, self._console.height - 1), refresh=True)

    def _tick(self, monitor: RunMonitor) -> None:
        self._processes.watch(training=monitor.trains)
        monitor.update()
        self._stop.event.wait(REFRESH_SECONDS)

    def _track(self, monitor: RunMonitor) -> tuple[str, ...]:
        """Give a tracker the learner's newest metrics; return what is wrong with it."""
        if self._tracker is None:
            return ()
        self._tracker.log(monitor.learner_values())
        return tuple(filter(None, (self._tracker.failure,)))

    def _drain(self, bus: Bus) -> None:
        self._console.print("draining; the learner is writing a checkpoint ...", highlight=False)
        if refused := self._processes.drain(bus):
            self._console.print(f"the learner refused to drain: {refused}", highlight=False)
