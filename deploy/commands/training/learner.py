"""`eia-sec learner`: the learner alone, listening itself or connected to a router."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Annotated, Final

import tyro

from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import UsageError
from eia_sec.common.log import log
from eia_sec.common.names import check_name
from eia_sec.common.team import TeamSpec
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.local.learner_group import following, leading
from eia_sec.deploy.local.learners import chosen_place, given_place, require_learners
from eia_sec.deploy.local.local_runs import LocalRun, listed
from eia_sec.deploy.local.run_directory import RunDirectory
from eia_sec.deploy.local.served_environments import tried_spec
from eia_sec.deploy.options import PRESET_HELP, base_configuration, parse
from eia_sec.learner.networks.device import usable_device
from eia_sec.learner.process.options import LearnerOptions
from eia_sec.learner.process.service import serve
from eia_sec.rollout.envs.registry import environment_spec, spec_of_team
from eia_sec.rollout.start_policy import StartParameters, start_parameters, start_sentence
from eia_sec.rollout.worker.outages import Outages

EVERYWHERE: Final = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}
"""Where this machine reaches itself when it listens at all of its addresses."""


@dataclass(frozen=True)
class LearnerArguments:
    """Start the learner alone."""

    run: str = "farm"
    """Name of the run; workers and the coordinator use the same."""
    listen: str | None = None
    """Endpoint to listen on (control lane; the bulk lane uses the next port). Default: tcp/127.0.0.1:7447."""
    connect: str | None = None
    """Endpoint of a router to connect to instead of listening."""
    tls: Path | None = None
    """Folder with the learner's certificate (`eia-sec keys issue learner learner`); turns TLS on."""
    shared_memory: bool = False
    """Take transitions through shared memory from workers on this machine that do the same."""
    insecure: bool = False
    """Listen on an address that other machines reach, without authentication."""
    preset: Annotated[str, tyro.conf.arg(help=PRESET_HELP)] = ""
    config: Path | None = None
    """TOML file whose values override the preset's."""
    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensor positions; workers get them with the configuration."""
    run_dir: Path | None = None
    """Folder for checkpoints, metrics and the policy. Default: nothing is saved."""
    resume: bool = False
    """Resume from the newest intact checkpoint in the run directory."""
    resume_if_any: bool = False
    """Resume if the run directory holds a run, else start one; for a supervisor that restarts the learner."""
    patience: float = 60.0
    """Seconds to wait for a router."""
    lockstep: bool = False
    """Alternate strictly with one worker: the result is bit-equal to training in a single process."""
    learners: int = 1
    """Learners on this machine that make the updates together, each with a share of every minibatch (on policy)."""
    await_elite: bool = False
    """Hold new experience for up to 20 s when an imitation event is a full cycle late, even before a coordinator
    has joined; for launchers that start one."""
    settings: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def command(arguments: Sequence[str]) -> int:
    """Run the learner, or follow another one, until the run ends; return 0."""
    given = given_place()
    if given is not None and given.leader:
        following(given)
        return 0
    defaults = LearnerArguments(settings=base_configuration(arguments))
    options = parse(LearnerArguments, arguments, "learner", defaults)
    within(0.0, 1e9, patience=options.patience)
    place = chosen_place(options.learners, insecure=options.insecure)
    require_learners(options.settings, place.size, lockstep=options.lockstep)
    if place.rank:
        following(place)
        return 0
    if options.listen and options.connect:
        raise UsageError("give --listen or --connect, not both.")
    resume = options.resume
    if (resume or options.resume_if_any) and options.run_dir is None:
        raise UsageError("--resume needs --run-dir.")
    if options.resume_if_any and options.run_dir is not None:
        resume = RunDirectory(options.run_dir).holds_run()
    if resume and options.lockstep:
        raise UsageError("a lockstep run cannot be resumed: its worker would restart with its first episode.")
    check_name(options.run, "run")
    where = options.connect or options.listen or DEFAULT
    endpoint = Endpoint.parse(where, options.tls, shared_memory=options.shared_memory)
    if endpoint.credentials is not None:
        endpoint.credentials.require("learner")
    if not options.connect:
        endpoint.require_private(options.insecure)
    # What cannot be trained, or cannot be begun with, is refused before any file is written.
    usable_device(options.settings.learner.device)
    environment = _environment(options, endpoint)
    if not resume:
        options.settings.algorithm.require_types(environment.team.types)
        start_parameters(options.settings, environment.team)
    if options.run_dir is not None:
        directory = RunDirectory(options.run_dir)
        directory.prepare(options.settings, resume=resume)
        directory.lock("learner.lock", directory=True)
        directory.adopt(options.settings, environment.team)
    with listed(_local_run(options, endpoint)):
        serve(
            LearnerOptions(
                run=options.run,
                endpoint=endpoint,
                listen=not options.connect,
                run_dir=options.run_dir,
                resume=resume,
                lockstep=options.lockstep,
                patience=options.patience,
                await_elite=options.await_elite,
                start=partial(_start, options.settings, environment.team),
                group=partial(leading, place, options.settings, environment.team),
            ),
            options.settings,
            environment,
        )
    return 0


def _local_run(options: LearnerArguments, endpoint: Endpoint) -> LocalRun:
    """Return how monitors of this machine find the run."""
    near = replace(endpoint, host=EVERYWHERE.get(endpoint.host, endpoint.host))
    run_dir = "" if options.run_dir is None else str(options.run_dir.resolve())
    return LocalRun(options.run, str(near), run_dir, options.settings.env.name, tls=endpoint.credentials is not None)


def _environment(options: LearnerArguments, endpoint: Endpoint) -> EnvironmentSpec:
    """Return the run's environment; that of a run directory is known, and one that others serve is asked for."""
    config = options.settings
    if not config.env.served:
        return environment_spec(config, patience=Outages(Event()))
    team = None if options.run_dir is None else RunDirectory(options.run_dir).team()
    if team is not None:
        return spec_of_team(config, team)
    return tried_spec(config, endpoint, connect=options.connect is not None)


def _start(config: RunConfig, team: TeamSpec) -> StartParameters:
    """Return what actors begin with, and log which types do."""
    if start := start_parameters(config, team):
        log(f"the run {start_sentence(config, team, start)}.")
    return start
