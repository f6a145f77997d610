"""`eia-sec learner`: the learner alone, listening itself or behind a router."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from common.config import RunConfig
from common.errors import UsageError
from common.transport.endpoint import DEFAULT, Endpoint
from deploy.local.run_directory import RunDirectory
from deploy.options import base_configuration, parse
from learner.networks.device import usable_device
from learner.options import LearnerOptions
from learner.service import serve
from rollout.envs.registry import environment_spec


@dataclass(frozen=True)
class LearnerArguments:
    """Start the learner alone."""

    run: str = "farm"
    """Name of the run; workers and coordinator give the same."""
    listen: str | None = None
    """Endpoint to listen on (control lane; the bulk lane takes the next port). Default: tcp/127.0.0.1:7447."""
    connect: str | None = None
    """Endpoint of a router, instead of listening."""
    tls: Path | None = None
    """Folder with the learner's certificate, made by `eia-sec keys issue learner learner`; links are TLS then."""
    shared_memory: bool = False
    """Take transitions through this machine's memory from workers that do so, too; from others they come as always."""
    insecure: bool = False
    """Listen on an address that other machines reach, without authentication."""
    preset: str = "default"
    """Configuration to begin from: default, quick, study or paper."""
    config: Path | None = None
    """TOML file with values that replace the preset's; what it leaves out is the preset's."""
    farm_file: Path | None = None
    """CSV or GeoJSON file with the sensors' places; workers get them with the configuration."""
    run_dir: Path | None = None
    """Folder for checkpoints, metrics and the policy; without it nothing is kept."""
    resume: bool = False
    """Go on from the newest whole checkpoint in the folder."""
    resume_if_any: bool = False
    """As --resume when the folder holds a run already, else begin one; for whatever starts it again unattended."""
    patience: float = 60.0
    """Seconds to wait for a router."""
    lockstep: bool = False
    """Take turns with exactly one worker, so that the outcome is bit-equal to a run inside one process."""
    await_elite: bool = False
    """An imitation event that is a whole cycle late holds new experience, for 20 s at most, even before a coordinator
    has come; for whatever starts one, too."""
    settings: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def command(arguments: Sequence[str]) -> int:
    """Run the learner until it is done; return 0."""
    defaults = LearnerArguments(settings=base_configuration(arguments))
    options = parse(LearnerArguments, arguments, "learner", defaults)
    if options.listen and options.connect:
        raise UsageError("give --listen or --connect, not both.")
    resume = options.resume
    if (resume or options.resume_if_any) and options.run_dir is None:
        raise UsageError("--resume needs --run-dir.")
    if options.resume_if_any and options.run_dir is not None:
        resume = RunDirectory(options.run_dir).holds_run()
    if resume and options.lockstep:
        raise UsageError("a lockstep run cannot be resumed: its one worker begins again with its first episode.")
    where = options.connect or options.listen or DEFAULT
    endpoint = Endpoint.parse(where, options.tls, shared_memory=options.shared_memory)
    if endpoint.credentials is not None:
        endpoint.credentials.require("learner")
    if not options.connect:
        endpoint.require_private(options.insecure)
    usable_device(options.settings.learner.device)  # a mistake to tell before anything is made, as the next one
    environment = environment_spec(options.settings)
    if options.run_dir is not None:
        directory = RunDirectory(options.run_dir)
        directory.prepare(options.settings, resume=resume)
        directory.lock("learner.lock", directory=True)
        directory.adopt(options.settings)
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
        ),
        options.settings,
        environment,
    )
    return 0
